r"""A signal filtered by a damped vibration, y'' + 2 z w y' + w^2 y = w^2 u, exact for piecewise linear u.

Between two samples y is u - 2 z s/w, with s the slope of u, plus a decaying oscillation. Two steps give a recursion

    y_k + a1 y_{k-1} + a2 y_{k-2} = b0 u_k + b1 u_{k-1} + b2 u_{k-2}

(Franklin, Powell & Workman, Digital Control, 3rd ed., §6.3, first-order hold). A vibration that is too fast for the
samples is left out: there y = u, and in between the two are blended, so that y has derivatives everywhere.
"""

import casadi as ca
import numpy as np

from armdyn.physics.definition import Expression

MAX_SIMULATED_RADIANS_PER_SAMPLE, MIN_IGNORED_RADIANS_PER_SAMPLE = 1.5, 3.0
"""Frequency up to which a vibration is simulated, and frequency from which it is ignored, in radians per sample; pi is
the Nyquist frequency."""
VIBRATION_TIME_ADDED_IN_SAMPLES = 1.0 / 200.0
"""Time, in samples, that is added in quadrature to 1/w, so that derivatives exist where there is no vibration."""


class Vibration:
    """Response of a damped oscillator to a sampled signal, with exact derivatives by its parameters.

    Args:
        settings: function ``theta -> (2,)`` that gives 1/w^2 in s^2 and the damping ratio z < 1.
    """

    def __init__(self, settings: ca.Function) -> None:
        theta, dt = ca.SX.sym("theta", settings.size1_in(0)), ca.SX.sym("dt")
        given = settings(theta)
        square, damping = ca.SX.sym("square"), ca.SX.sym("damping")
        numbers = _recursion(square, damping, dt)
        self._recursion = ca.Function(
            "recursion", [square, damping, dt], [numbers, ca.jacobian(numbers, ca.vertcat(square, damping))]
        )
        self._settings = ca.Function("settings", [theta], [given, ca.densify(ca.jacobian(given, theta))])

    def response(
        self, signal: np.ndarray, by_theta: np.ndarray, theta: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Response of the vibration, which starts at rest, to a signal.

        Args:
            signal: (K,) samples at even times.
            by_theta: (K, m) derivatives of the signal, those by theta first.
            theta: (p,) parameters in the order of the settings.
            dt: interval between the samples, s.

        Returns:
            (K,) response and (K, m) its derivatives.
        """
        from scipy.signal import lfilter  # brings scipy.stats, half a second, and few sensors vibrate

        settings, by_settings = (np.asarray(x) for x in self._settings(theta))
        b, a, db, da = self._numbers(settings, dt)
        both = np.column_stack([signal, by_theta])
        after = both[0] + lfilter(b, a, both - both[0], axis=0)
        moved, followed = signal - signal[0], after[:, 0] - signal[0]
        for k in range(2):
            change = lfilter(db[:, k], a, moved) - lfilter(np.append(0.0, da[:, k]), a, followed)
            after[:, 1 : 1 + len(theta)] += np.outer(change, by_settings[k])
        return after[:, 0], after[:, 1:]

    def adjoint(self, weights: np.ndarray, theta: np.ndarray, dt: float) -> np.ndarray:
        """(K,) weights w' with sum w' u = sum w y, for (K,) `weights` w of the response y to a signal u."""
        from scipy.signal import lfilter

        b, a, *_ = self._numbers(np.asarray(self._settings(theta)[0]), dt)
        earlier = lfilter(b, a, weights[::-1])[::-1].copy()
        earlier[0] += weights.sum() - earlier.sum()
        return np.asarray(earlier)

    def _numbers(self, settings: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(3,) coefficients b and a, and their derivatives by 1/w^2 and z, (3, 2) and (2, 2)."""
        numbers, slopes = (np.asarray(x) for x in self._recursion(*settings.ravel(), dt))
        return numbers[:3, 0], np.append(1.0, numbers[3:, 0]), slopes[:3], slopes[3:]


def _recursion(square: Expression, damping: Expression, dt: Expression) -> Expression:
    """(5,) coefficients b0, b1, b2, a1, a2."""
    w = 1 / ca.sqrt(square + (VIBRATION_TIME_ADDED_IN_SAMPLES * dt) ** 2)
    decay, turn = damping * w, w * ca.sqrt(1 - damping**2)
    size, cos, sin = ca.exp(-decay * dt), ca.cos(turn * dt), ca.sin(turn * dt)
    # (y, y') without the non-oscillating part, one step on
    M = size * ca.blockcat([[cos + decay / turn * sin, sin / turn], [-(w**2) * sin / turn, cos - decay / turn * sin]])
    lag = 2 * damping / w
    slope = ca.DM([[-1.0, 1.0]]) / dt  # of u, from u_k and u_{k+1}
    begin = ca.vertcat(ca.DM([[1.0, 0.0]]) - lag * slope, slope)
    end = ca.vertcat(ca.DM([[0.0, 1.0]]) - lag * slope, slope)
    N = end - M @ begin
    a1, a2 = -(M[0, 0] + M[1, 1]), size**2
    b = (N[0, 1], N[0, 0] - M[1, 1] * N[0, 1] + M[0, 1] * N[1, 1], M[0, 1] * N[1, 0] - M[1, 1] * N[0, 0])
    beyond = ca.fmin(
        ca.fmax(
            (w * dt - MAX_SIMULATED_RADIANS_PER_SAMPLE)
            / (MIN_IGNORED_RADIANS_PER_SAMPLE - MAX_SIMULATED_RADIANS_PER_SAMPLE),
            0,
        ),
        1,
    )
    left_out = beyond**2 * (3 - 2 * beyond)
    mixed = [(1 - left_out) * numerator + left_out * same for numerator, same in zip(b, (1, a1, a2), strict=True)]
    return ca.vertcat(*mixed, a1, a2)
