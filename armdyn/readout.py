"""Compute what a sensor reads of a signal: gain, lag, dead time, low-pass and sampling; with exact derivatives.

The signal, such as the torque along a recorded motion or the output of a simulation, is given at nodes: the time stamps
of the recording or the time grid of the simulation.
"""

from abc import ABC, abstractmethod

import casadi as ca
import numpy as np
from scipy.linalg import solve_banded
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csr_matrix

from armdyn.codegen import PreallocatedFunction
from armdyn.physics.definition import Expression
from armdyn.smoothing.spline import MAX_UNDISTORTED_CUTOFF_PER_KNOT, LowPass, SplineSamples, basis_matrix

NODE_TOLERANCE = 1e-9
"""Distance of a sample from a node, in intervals between nodes, below which the node's value is used as it is."""
CACHED_MATRICES = 2
"""Number of matrices with a dead time that a sampler caches: samples and their time derivative, of one dead time."""


class Sampler(ABC):
    """Base class of linear maps from signals at nodes to samples at other times, with a dead time."""

    nodes: np.ndarray
    """(K,) times of the nodes, s."""

    @abstractmethod
    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """(N, m) coefficients of the curves through m signals, given as (K, m) values at the nodes."""

    def weighted_coefficients(self, weights: np.ndarray, signals: np.ndarray) -> np.ndarray:
        """(N, m) `coefficients` of (K, m) signals times (K,) weights."""
        return self.coefficients(weights[:, None] * signals)

    @abstractmethod
    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """(n, N) matrix from the coefficients to the samples, or to a time derivative of them.

        Args:
            delay: dead time, s: a sample shows the signal that much earlier.
            derivative: order of the time derivative.
        """


class InterpolatingSampler(Sampler):
    """Sampler that interpolates the signal by cubic polynomials between the nodes.

    After the last node the signal is constant; before the first node it continues with its first slope.

    Args:
        nodes: (K,) times of the nodes, s, K >= 4.
        time: (n,) times of the samples, s.
        spread: variance, s^2, of the times over which each sample is a mean; 0 for samples at one instant. Other values
            need equally spaced nodes.
    """

    def __init__(self, nodes: np.ndarray, time: np.ndarray, spread: float = 0.0) -> None:
        self.nodes, self._time, self._spread = nodes, time, spread
        self._made_before: dict[tuple[float, int], csr_matrix] = {}

    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """The coefficients, which are the signals themselves; see `Sampler.coefficients`."""
        return signals

    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """Interpolation matrix, see `Sampler.matrix`; the last few are cached, those without delay above all."""
        found = self._made_before.pop((delay, derivative), None)
        if found is None:
            found = self._made(delay, derivative)
        self._made_before[delay, derivative] = found  # the most recent one is the last
        late = [key for key in self._made_before if key[0]]
        if len(late) > CACHED_MATRICES:
            del self._made_before[late[0]]
        return found

    def _made(self, delay: float, derivative: int) -> csr_matrix:
        found = self._instants(delay, derivative)
        if not self._spread or derivative:
            return found
        # The mean of y over times around t is y + y'' spread/2, to third order.
        nodes = self.nodes
        step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
        middle = np.clip(np.rint((self._time - delay - nodes[0]) / step).astype(int), 1, len(nodes) - 2)
        bend = 0.5 * self._spread / step**2 * np.tile([1.0, -2.0, 1.0], (len(middle), 1))
        return found + _rows(bend, middle[:, None] + [-1, 0, 1], len(nodes))

    def _instants(self, delay: float, derivative: int) -> csr_matrix:
        """The `matrix` for samples at instants, which are not means."""
        nodes = self.nodes
        at = np.clip(self._time, nodes[0], None) - delay
        inside = np.clip(at, nodes[0], nodes[-1])
        after = np.clip(np.searchsorted(nodes, inside), 1, len(nodes) - 1)
        nearest = after - (inside - nodes[after - 1] < nodes[after] - inside)
        interval = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
        if np.max(np.abs(at - nodes[nearest]), initial=0.0) < NODE_TOLERANCE * interval:
            if not derivative:
                return _rows(np.ones((len(at), 1)), nearest[:, None], len(nodes))
            columns = np.clip(nearest[:, None] + [-1, 1], 0, len(nodes) - 1)
            secants = 1.0 / (nodes[columns[:, 1]] - nodes[columns[:, 0]])
            return _rows(np.stack([-secants, secants], axis=1), columns, len(nodes))
        first = np.clip(np.searchsorted(nodes, inside, side="right") - 2, 0, len(nodes) - 4)
        columns = first[:, None] + np.arange(4)
        p, values = nodes[columns], np.empty((len(at), 4))
        for i in range(4):  # Lagrange's polynomials
            others = [k for k in range(4) if k != i]
            base = np.prod([p[:, i] - p[:, k] for k in others], axis=0)
            factors = [[m for m in others if m != k] for k in others] if derivative else [others]
            values[:, i] = sum(np.prod([inside - p[:, m] for m in of], axis=0) for of in factors) / base
        if derivative:
            values[inside != at] = 0.0
        before = at < nodes[0]
        step = nodes[1] - nodes[0]
        on = np.full(int(before.sum()), 1.0 / step) if derivative else (at[before] - nodes[0]) / step
        values[before] = np.stack([-on if derivative else 1.0 - on, on, 0.0 * on, 0.0 * on], axis=1)
        return _rows(values, columns, len(nodes))


class LowPassSampler(Sampler):
    """Sampler that low-passes the signal without phase shift.

    Args:
        nodes: (K,) times of the nodes, s.
        cutoff: cut-off of the low-pass, Hz.
        time: (n,) times of the samples, s.
        used: (K,) bool, nodes that the low-pass uses.
        recorded_below: cut-off, Hz, of an earlier low-pass in the recording, over all nodes: a Butterworth filter of
            second order forwards and backwards; None where there was none.
    """

    def __init__(
        self,
        nodes: np.ndarray,
        cutoff: float,
        time: np.ndarray,
        used: np.ndarray,
        recorded_below: float | None = None,
    ) -> None:
        self.nodes, self._time, self._before = nodes, time, None
        self._used = np.flatnonzero(used)
        if recorded_below is not None:
            # Penalised second differences pass 1 / (1 + (f/f_c)^4), as that filter does.
            self._before = LowPass(
                SplineSamples(nodes, MAX_UNDISTORTED_CUTOFF_PER_KNOT / recorded_below, order=2), recorded_below
            )
        self._filter = LowPass(SplineSamples(nodes[used], MAX_UNDISTORTED_CUTOFF_PER_KNOT / cutoff), cutoff)

    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """Coefficients of the smoothed signals; see `Sampler.coefficients`."""
        if self._before is not None:
            signals = self._before.curve(signals)(self.nodes)
        return self._filter.curve(signals[self._used]).coefficients

    def weighted_coefficients(self, weights: np.ndarray, signals: np.ndarray) -> np.ndarray:
        """Coefficients of weighted signals, without the memory of their product; see `Sampler`."""
        basis = self._filter.samples.matrix
        if self._before is not None or self._filter.needs_refinement:
            return super().weighted_coefficients(weights, signals)
        rows = np.zeros(len(self.nodes) + 1, dtype=basis.indptr.dtype)
        rows[self._used + 1] = np.diff(basis.indptr)
        scaled = basis.data * np.repeat(weights[self._used], np.diff(basis.indptr))
        weighted = csr_matrix((scaled, basis.indices, np.cumsum(rows)), shape=(len(self.nodes), basis.shape[1]))
        return self._filter.solution(weighted.T @ signals)

    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """Matrix from coefficients to samples; see `Sampler.matrix`."""
        samples, at = self._filter.samples, self._time - delay
        matrix = basis_matrix(np.clip(at, self.nodes[0], None), samples.start, samples.step, samples.size, derivative)
        return matrix.multiply((at >= self.nodes[0])[:, None]).tocsr() if derivative else matrix


class SensorReadout:
    """A sensor with gain, first-order lag and dead time: reading(t) = [gain quantity]_lagged (t - delay).

    Its methods take and return signals (K, 1 + m): the quantity at K times, and its derivatives with respect to m
    parameters, those of `theta` first.

    Args:
        theta: (p,) symbols of the parameters.
        gain: gain of the reading, an expression of `theta`.
        lag: first-order time constant, s.
        delay: dead time, s.

    Attributes:
        amplifies: whether the gain depends on parameters.
        lags: whether there is a lag.
        delays: whether there is a dead time.
    """

    def __init__(self, theta: Expression, gain: Expression = 1, lag: Expression = 0, delay: Expression = 0) -> None:
        settings = ca.densify(ca.SX(ca.vertcat(gain, lag, delay)))
        self._function = PreallocatedFunction(
            ca.Function("sensor", [theta], [settings, ca.densify(ca.jacobian(settings, theta))])
        )
        depends = (ca.which_depends(settings[i], theta, 1, False) if theta.numel() else [] for i in range(3))
        self._columns = [np.flatnonzero(which) for which in depends]
        self.amplifies = len(self._columns[0]) > 0
        self.lags, self.delays = (not ca.SX(expression).is_zero() for expression in (lag, delay))

    def delay(self, theta: np.ndarray) -> float:
        """Dead time, s, for (p,) parameter values."""
        return float(self._function(theta)[0][2, 0])

    def gain(self, theta: np.ndarray) -> float:
        """Gain for (p,) parameter values."""
        return float(self._function(theta)[0][0, 0])

    def amplify(self, signal: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Multiply a signal (K, 1 + m) by the gain, for (p,) parameter values."""
        if not self.amplifies:
            return signal
        amplified = signal * self.gain(theta)
        return self._with(amplified, 0, signal[:, 0], theta)

    def apply_lag(self, signal: np.ndarray, theta: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Apply the first-order lag to a signal (K, 1 + m); before the start it had its first slope.

        Args:
            signal: (K, 1 + m) signal.
            theta: (p,) parameter values.
            nodes: (K,) times of the signal, s.
        """
        if not self.lags:
            return signal
        tau, steps = float(self._function(theta)[0][1, 0]), np.diff(nodes)
        slope = (signal[1] - signal[0]) / steps[0]
        following, by_lag = first_order_lag(signal, tau, steps, signal[0] - tau * slope, float(-slope[0]))
        return self._with(following, 1, by_lag, theta)

    def read(self, signal: np.ndarray, sampler: Sampler, theta: np.ndarray) -> np.ndarray:
        """(n, 1 + m) samples with lag and dead time of a signal (K, 1 + m) that already has the gain."""
        return self.sample(sampler.coefficients(self.apply_lag(signal, theta, sampler.nodes)), sampler, theta)

    def adjoint(self, weights: np.ndarray, sampler: Sampler, theta: np.ndarray) -> np.ndarray:
        """(K,) weights of the quantity at the nodes whose weighted sum is that of the samples with (n,) `weights`.

        It is the adjoint of `read`, for a sampler whose coefficients are the signal, as for `InterpolatingSampler`.
        """
        signal = np.asarray(sampler.matrix(self.delay(theta) if self.delays else 0.0).T @ weights)
        if not self.lags:
            return signal
        tau, steps = float(self._function(theta)[0][1, 0]), np.diff(sampler.nodes)
        e, share = _lag_shares(tau, steps)
        bands = np.vstack([np.append(0.0, -e), np.ones(len(signal))])
        follows = np.asarray(solve_banded((0, 1), bands, signal, check_finite=False))
        weighted = np.append(follows[:1], (1.0 - share) * follows[1:])
        weighted[:-1] += (share - e) * follows[1:]
        weighted[:2] += np.array([1.0, -1.0]) * follows[0] * tau / steps[0]
        return weighted

    def sample(self, coefficients: np.ndarray, sampler: Sampler, theta: np.ndarray) -> np.ndarray:
        """(n, 1 + m) samples with dead time of a signal that is given by its (N, 1 + m) coefficients."""
        delay = self.delay(theta) if self.delays else 0.0
        samples = np.asarray(sampler.matrix(delay) @ coefficients)
        return self.add_delay_derivatives(samples, coefficients[:, 0], sampler, theta)

    def add_delay_derivatives(
        self,
        samples: np.ndarray,
        coefficients: np.ndarray,
        sampler: Sampler,
        theta: np.ndarray,
        delay: float | None = None,
    ) -> np.ndarray:
        """Add the derivatives with respect to the dead time to samples (n, 1 + m).

        Args:
            samples: (n, 1 + m) samples that already have the dead time.
            coefficients: (N,) coefficients of the quantity.
            sampler: the sampler of these coefficients.
            theta: (p,) parameter values.
            delay: dead time, s, that the coefficients do not include; None means all of it.
        """
        if not self.delays:
            return samples
        at = self.delay(theta) if delay is None else delay
        return self._with(samples, 2, -(sampler.matrix(at, 1) @ coefficients), theta)

    def _with(self, signal: np.ndarray, setting: int, slope: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """The signal with the derivative by a setting (`slope`) added by the chain rule."""
        derivatives = self._function(theta)[1]
        for column in self._columns[setting]:
            signal[:, 1 + column] += slope * derivatives[setting, column]
        return signal


def first_order_lag(
    values: np.ndarray,
    time_constant: float,
    step: float | np.ndarray,
    start: float | np.ndarray | None = None,
    start_by_lag: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Apply a first-order lag to a signal that is linear between samples, and differentiate it by the lag.

    z_{k+1} = e z_k + b y_k + c y_{k+1}, e = exp(-dt/tau), c = 1 - (1 - e) tau/dt, b = (1 - e) tau/dt - e: exact for
    the interpolated signal, and regular at tau = 0, where z = y and dz/dtau = -(y_{k+1} - y_k)/dt.
    (Franklin, Powell & Workman, Digital Control, 3rd ed., §6.3, first-order hold.)

    Args:
        values: (K, m) samples, whose columns are filtered independently.
        time_constant: time constant tau, s, >= 0.
        step: interval dt between the samples, s, a number or (K-1,).
        start: start values of the filtered columns; by default equilibrium.
        start_by_lag: derivative of the first column's start value with respect to tau.

    Returns:
        (K, m) filtered values, and (K,) derivative of the first column with respect to tau.
    """
    tau, dt = time_constant, np.broadcast_to(step, len(values) - 1)
    e, share = _lag_shares(tau, dt)
    if tau < 1e-3 * dt.min():
        de, dshare = 0.0 * dt, 1.0 / dt
    else:
        de = e * dt / tau**2
        dshare = (1.0 - e) / dt - de * tau / dt
    y, first = values, values[:1].astype(float)
    if start is not None:
        first[:] = start
    z = _recursive(e, (share - e)[:, None] * y[:-1] + (1.0 - share)[:, None] * y[1:], first)
    drive = de * z[:-1, 0] + (dshare - de) * y[:-1, 0] - dshare * y[1:, 0]
    return z, _recursive(e, drive[:, None], np.array([[start_by_lag]]))[:, 0]


def _lag_shares(time_constant: float, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K-1,) e and (1 - e) tau/dt of a lag over steps; see `first_order_lag`."""
    if time_constant < 1e-3 * step.min():  # e underflows to zero and every term but the linear one with it
        return np.zeros_like(step), max(time_constant, 0.0) / step
    e = np.exp(-step / time_constant)
    return e, (1.0 - e) * time_constant / step


def _recursive(decay: np.ndarray, drive: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(K, m) z with z_0 = first (1, m) and z_{k+1} = decay_k z_k + drive_k."""
    if not decay.any():  # no lag, as where it is a candidate that is absent
        return np.concatenate([first, drive])
    bands = np.vstack([np.ones(len(decay) + 1), np.append(-decay, 0.0)])
    found, _ = dtbtrs(bands, np.concatenate([first, drive]), uplo="L", diag="U")
    return np.asarray(found)


def _rows(values: np.ndarray, columns: np.ndarray, size: int) -> csr_matrix:
    """(n, size) matrix with (n, k) values in (n, k) columns."""
    n, k = values.shape
    return csr_matrix((values.ravel(), columns.ravel(), np.arange(0, n * k + 1, k)), shape=(n, size))
