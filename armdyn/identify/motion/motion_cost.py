"""The cost of a fit to the motion of an arm: a robust sum of the position errors of simulated windows.

Position errors are weighted, in each step, by the size of those that the step before has left; the states in which
windows begin are eliminated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.closed_loop.motion_slopes import INPUT_DIFFERENCE, window_slopes
from armdyn.arm.closed_loop.rollout import (
    MAX_ROLLOUT_STEP_SECONDS,
    SimulationWindow,
    encoder_step,
    simulate_window,
    simulated_positions,
    simulation_windows,
)
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import measured_motion
from armdyn.estimation.correlation import INDEPENDENT_STRETCH_SECONDS, correlation_time
from armdyn.estimation.covariance import free_covariance, sandwich_covariance
from armdyn.estimation.descent import Damping, DescentSettings, descend
from armdyn.estimation.nuisance import ArrowheadExpansion, eliminate_nuisance
from armdyn.estimation.solve import marginal_information
from armdyn.identify.motion.motion_unknowns import MotionUnknown, model_at
from armdyn.run import Run

CLOSED_LOOP_WINDOW_SECONDS, OPEN_LOOP_WINDOW_SECONDS = (2.0, np.inf), (0.5,)
"""Lengths, s, of the windows of successive fits: for drives with a position command, and for those without one, whose
simulation drifts away."""
MAX_LAST_WINDOW_FIT_STEPS, MAX_EARLIER_WINDOW_FIT_STEPS = 30, 6
"""Largest number of steps of the fit over the last, longest windows, and of the fits over shorter windows before it,
which only lead near its solution."""
MIN_LIKELIHOOD_GAIN_PER_STEP_NATS = 0.1
"""Gain of log likelihood, nats, below which a step is the last one: it moves no value by half a standard deviation."""
MAX_SIMULATIONS_PER_STEP = 6
"""Largest number of simulations, each with a shorter step, to find one that lowers the cost."""
MOTION_DAMPING = Damping(first=1e-6, least=1e-9, negligible=5e-9, after_failure=0.0, growth=8.0, relief=5.0)
"""Damping of the steps. With the usual one, which is far stronger after a failure, values of eleven fits of servo arms
move by up to 0.08 standard deviations, and their likelihoods by -0.002 to 0.02 nats."""
RIDGE_PER_TYPICAL_SIZE = 1e-12
"""Curvature, in inverse squared typical sizes, that keeps values which the motion does not show."""
NEGLIGIBLE_CURVATURE_SHARE = 1e-15
"""Share of the largest curvature below which a direction of the values is only rounding."""
SLOPE_STEP_SECONDS = 0.004
"""Usual step of the integration of derivatives, s; they need less accuracy than the motion itself."""
WINDOW_START_PRIOR_STD_FACTOR = 3.0
"""Prior standard deviation of a window's start state, in standard deviations of the smoothed measured motion."""
CLOSED_LOOP_ROBUST_ERROR_RATIO, OPEN_LOOP_ROBUST_ERROR_RATIO = 0.5, 20.0
"""Ratio of an error to the median error above which it counts with its size, not its square (in closed and open loop):
after a collision a simulation of a whole recording diverges; the short windows of an open loop do not. Errors up to an
encoder's step always count with their square: otherwise they would shift torque offsets by eleven standard deviations.
"""
MIN_POSITION_ERROR_AUTOCORRELATION = 0.05
"""Autocorrelation below which the sum for the correlation time of the position errors ends."""


def robust_sum(errors: np.ndarray, size: np.ndarray) -> float:
    """Half the mean squares of (N, nj) errors in units of (nj,) sizes; from these sizes on, an error counts as such."""
    return float(np.mean(np.sqrt(1.0 + (errors / size) ** 2) - 1.0, axis=0).sum())


@dataclass(frozen=True, eq=False)
class _Weights:
    """Weights of the cost of a fit, from the errors before a step.

    Attributes:
        size: (nj,) errors from which on an error counts with its size instead of its square, rad or m.
        nats: nats per unit of the robust sum of errors.
        prior: (u,) weights of the squared distances of the values from their prior means, nats.
        start: (w, 2 nj) weights of the squared distances of start states from the measured ones, nats.
        score_variance: (u,) variances of the slopes of the priors.
    """

    size: np.ndarray
    nats: float
    prior: np.ndarray
    start: np.ndarray
    score_variance: np.ndarray

    def of_samples(self, errors: np.ndarray) -> np.ndarray:
        """(N, nj) weights of the squares of (N, nj) errors that have the same slope as the cost."""
        return self.nats / np.sqrt(1.0 + (errors / self.size) ** 2) / self.size**2 / len(errors)


class MotionCost:
    """The cost of a fit to windows of one length, whose start states are fitted as well.

    It is half the squared distances of values and start states from their priors, and a robust sum of the position
    errors, which each step weights by the size of the errors that the step before has left. The first unknowns are the
    values, then come the deviations of the windows' start states from the measured ones.

    Args:
        model: the arm.
        runs: training runs.
        unknowns: the unknowns of the fit.
        length: length of the windows, s.
        longest: longest step of the simulation, s.
    """

    def __init__(
        self, model: ArmModel, runs: Sequence[Run], unknowns: Sequence[MotionUnknown], length: float, longest: float
    ) -> None:
        self._model, self._unknowns, self._longest = model, unknowns, longest
        self._robust = (
            OPEN_LOOP_ROBUST_ERROR_RATIO if length in OPEN_LOOP_WINDOW_SECONDS else CLOSED_LOOP_ROBUST_ERROR_RATIO
        )
        joints = model.arm.joints
        self._windows = [w for run in runs for w in simulation_windows(run, joints, length)]
        ends = np.cumsum([len(w.time) for w in self._windows]).tolist()
        self._rows = [slice(end - len(w.time), end) for w, end in zip(self._windows, ends, strict=True)]
        curves = [measured_motion(w.run, joints).joints for w in self._windows]
        noise = [[j.choice.noise for j in each] + [j.smoothed_velocity_noise_std for j in each] for each in curves]
        self._known = np.maximum(WINDOW_START_PRIOR_STD_FACTOR * np.array(noise), 1e-9)
        steps = [[encoder_step(w.run.channels[f"q.{j}"].value) for j in joints] for w in self._windows]
        self._step = np.maximum(np.max(steps, axis=0), 1e-9)
        self._typical = np.array([u.typical for u in unknowns])
        self._mean, self._spread = np.array([u.prior for u in unknowns]).T
        unbounded = np.full(self._known.size, np.inf)
        self.lower = np.append([u.lower for u in unknowns], -unbounded)
        self.upper = np.append([u.upper for u in unknowns], unbounded)
        self._simulated: tuple[bytes, np.ndarray] | None = None

    def fitted(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Minimise the cost from (u,) values: (u,) values, and their (u,) standard deviations, which are 0 on a bound.

        The standard deviations are those of the sandwich formula, over stretches of the recordings that are independent
        (Liang & Zeger, Biometrika 73, 1986).
        """
        last = self._longest == MAX_ROLLOUT_STEP_SECONDS
        settings = DescentSettings(
            MAX_LAST_WINDOW_FIT_STEPS if last else MAX_EARLIER_WINDOW_FIT_STEPS,
            tolerance=0.0,
            least_gain=MIN_LIKELIHOOD_GAIN_PER_STEP_NATS,
            most_tries=MAX_SIMULATIONS_PER_STEP,
            damping=MOTION_DAMPING,
        )
        found = descend(self, np.append(values, np.zeros(self._known.size)), settings)
        return found.values[: len(values)], self._deviations(found.values)

    def _split(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(u,) values and (w, 2 nj) deviations of start states from the measured ones."""
        values, starts = np.split(point, [len(self._unknowns)])
        return values, starts.reshape(self._known.shape)

    def _errors(self, point: np.ndarray) -> np.ndarray:
        """(N, nj) position errors; the last ones are kept."""
        if self._simulated is not None and self._simulated[0] == point.tobytes():
            return self._simulated[1]
        values, starts = self._split(point)
        model = model_at(self._model, self._unknowns, values)
        servos = [model.servo(joint) for joint in model.arm.joints]
        theta = model.theta()
        with np.errstate(all="ignore"):
            moved = [
                simulated_positions(model, theta, window, servos, self._longest) - window.q
                for window in self._begun(starts)
            ]
        found = np.clip(np.nan_to_num(np.vstack(moved), nan=100.0), -100.0, 100.0)
        self._simulated = point.tobytes(), found
        return found

    def _begun(self, starts: np.ndarray) -> list[SimulationWindow]:
        """The windows, from start states that deviate by (w, 2 nj) from the measured ones."""
        n = starts.shape[1] // 2
        return [
            replace(w, start=(w.start[0] + s[:n], w.start[1] + s[n:]))
            for w, s in zip(self._windows, starts, strict=True)
        ]

    def value(self, values: np.ndarray, limit: float) -> float:
        """The cost, nats, with the weights of the last expansion."""
        del limit
        return self._cost(values, self._errors(values))

    def _cost(self, point: np.ndarray, errors: np.ndarray) -> float:
        values, starts = self._split(point)
        priors = self._weights.prior @ (values - self._mean) ** 2 + np.sum(self._weights.start * starts**2)
        return self._weights.nats * robust_sum(errors, self._weights.size) + 0.5 * float(priors)

    def expand(self, values: np.ndarray) -> ArrowheadExpansion:
        """Weight the cost by the size of the errors, and expand it."""
        errors, (own, starts) = self._errors(values), self._split(values)
        size = np.maximum(self._robust * np.median(np.abs(errors), axis=0), self._step)
        independent = max(len(errors) / _correlation_time(errors / size), 1.0)
        prior, start = self._spread**-2.0 / independent, self._known**-2.0 / independent
        away = 0.5 * float(prior @ (own - self._mean) ** 2 + np.sum(start * starts**2))
        # Errors of the most probable size leave half a nat for each independent one.
        nats = 0.5 * independent * errors.shape[1] / (robust_sum(errors, size) + away)
        self._weights = _Weights(size, nats, nats * prior, nats * start, nats**2 * prior / independent)
        self._slopes, self._of_starts = self._derivatives(own, starts)
        self._share = self._weights.of_samples(errors)
        left = eliminate_nuisance(self._slopes, self._of_starts, self._share, self._rows, self._weights.start)
        pulls = self._share * errors
        gradient = self._weights.prior * (own - self._mean) + np.einsum("unj,nj->u", self._slopes, pulls)
        of_starts = [np.einsum("snj,nj->s", self._of_starts[:, rows], pulls[rows]) for rows in self._rows]
        by_starts = np.array(of_starts) + self._weights.start * starts
        H = left.hessian + np.diag(self._weights.prior)
        H += np.diag(nats * RIDGE_PER_TYPICAL_SIZE / self._typical**2)
        return ArrowheadExpansion(self._cost(values, errors), np.append(gradient, by_starts), H, left)

    def _deviations(self, point: np.ndarray) -> np.ndarray:
        """(u,) standard deviations of the free values at a minimum, with the derivatives of the last expansion.

        Scores are those of the samples, of the states in which windows begin, and of the priors, so that a value which
        only its prior determines is as uncertain as the prior.
        """
        errors, (values, starts), weights = self._errors(point), self._split(point), self._weights
        u, typical = len(values), self._typical
        free = (values > self.lower[:u]) & (values < self.upper[:u])
        # A full step would overestimate the curvature of the robust cost.
        curved = self._share / (1.0 + (errors / weights.size) ** 2)
        left = eliminate_nuisance(self._slopes, self._of_starts, curved, self._rows, weights.start)
        pulls = np.einsum("unj,nj->un", left.slopes, self._share * errors)
        begun = -np.einsum("wus,ws->uw", left.follow, weights.start * starts)
        times = [w.time - w.begin for w in self._windows]
        first = [rows.start + np.flatnonzero(np.diff(t // INDEPENDENT_STRETCH_SECONDS, prepend=-1.0))
                 for t, rows in zip(times, self._rows, strict=True)]  # fmt: skip
        sums = np.hstack([np.add.reduceat(pulls, np.concatenate(first), axis=1), begun])
        count, information = sums.shape[1], left.hessian + np.diag(weights.prior)
        inverse = free_covariance(information, free, NEGLIGIBLE_CURVATURE_SHARE)
        scores = sums @ sums.T * count / max(count - 1, 1) + np.diag(weights.score_variance)
        found = np.sqrt(np.diag(sandwich_covariance(inverse, scores)))
        for i, unknown in enumerate(self._unknowns):
            gain = self._model.drives[unknown.name].gain if unknown.of == "gain" else None
            if gain is not None and gain.std is not None and free[i]:  # no surer than what the gain is told with
                others = np.flatnonzero(free & (np.arange(u) != i))
                scaled = information * np.outer(typical, typical)
                _, follow = marginal_information(scaled, np.array([i]), others)
                follow = follow[:, 0] * typical[others] / typical[i]
                found[others] = np.hypot(found[others], follow * gain.std / gain.value)
        return found

    def _derivatives(self, values: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(u, N, nj) derivatives of the errors by the values, and (2 nj, N, nj) by the start states."""
        model = model_at(self._model, self._unknowns, values)
        joints, theta = model.arm.joints, model.theta()
        servos = [model.servo(joint) for joint in joints]
        through_inputs = [i for i, unknown in enumerate(self._unknowns) if unknown.acts_through_inputs]
        shifted = [self._shifted(i, values) for i in through_inputs]
        found = []
        with np.errstate(all="ignore"):
            for window in self._begun(starts):
                moved = simulate_window(model, theta, window, servos, self._longest)
                found.append(window_slopes(model, shifted, window, moved, SLOPE_STEP_SECONDS))
        derivatives = np.moveaxis(np.clip(np.nan_to_num(np.vstack(found)), -1e9, 1e9), 2, 0)
        of_shifted, of_starts = np.split(derivatives[len(theta) :], [len(shifted)])
        of_inputs = dict(zip(through_inputs, of_shifted / INPUT_DIFFERENCE, strict=True))
        of_values = [
            of_inputs[i] if i in of_inputs else derivatives[model.names.index(unknown.name)]
            for i, unknown in enumerate(self._unknowns)
        ]
        return np.array(of_values).reshape(-1, *derivatives.shape[1:]), of_starts

    def _shifted(self, unknown: int, values: np.ndarray) -> ArmModel:
        """The model with one unknown larger by `INPUT_DIFFERENCE`."""
        changed = values.copy()
        changed[unknown] += INPUT_DIFFERENCE
        return model_at(self._model, self._unknowns, changed)


def _correlation_time(errors: np.ndarray) -> float:
    """Correlation time, in samples, of (n, nj) errors, from the autocorrelation of all joints together."""
    lags = max(len(errors) // 4, 1)
    centred = errors - errors.mean(axis=0)
    return correlation_time(list(centred.T), lags, MIN_POSITION_ERROR_AUTOCORRELATION, max(1, lags // 400))
