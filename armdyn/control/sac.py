r"""Sequential Action Control: a needle of gripper acceleration that makes the load cell informative.

The extended state holds the gripper (x, v), the pendulum (phi, P) and psi = d(phi, P)/d(length). With
Gamma = dT/d(length) = h_s psi + h_length the cost over the horizon is

    J = sum dt [ G0^2 / (Gamma^2 + G0^2) + w_x x^2 + w_v v^2 + w_b max(0, |x| - x_b)^2 ].

One action is found in closed form from the first-order effect of a needle (mode insertion gradient) u2 g, g = dJ/du
per unit time along the free motion:  u2 = g alpha_d / (g^2 + R), alpha_d = gamma J. Its time minimises
|u2| + u2 g + (t - t0)^beta, its duration is the longest that lowers the cost.
(Ansari & Murphey, IEEE T-RO 2016; Wilson et al., IEEE T-ASE 2016. G0, the floor, is ours: at rest Gamma = 0.)

Gamma crosses zero within milliseconds, so the gradient is that of the discretised cost, by reverse differentiation.
"""

from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter

import casadi as ca
import numpy as np

from armdyn.codegen import Buffered, compiled
from armdyn.errors import InputError
from armdyn.pendulum.dynamics import STATE_SIZE, Dynamics
from armdyn.pendulum.model import PendulumModel

EXTENDED = 2 + 2 * STATE_SIZE
SETTINGS = ("information_floor", "position_weight", "velocity_weight", "barrier_weight", "barrier")


@dataclass(frozen=True)
class SacSettings:
    """Weights and limits; the defaults are the ones that were found to work for Baxter's line.

    Attributes:
        horizon: s.
        dt: integration step, s.
        sample_time: an action is chosen this often, s.
        control_weight: R, 1/(m/s^2)^2.
        desired_change: gamma < 0, the desired relative change of the cost.
        largest_acceleration: m/s^2.
        largest_speed: of the gripper, m/s; actions that would pass it are cut.
        time_exponent: beta, how much a later action is disliked.
        first_duration: of a needle, s; halved until the cost falls.
        halvings: at most.
        information_floor: G0, N/m; a floor on |Gamma|.
        position_weight: w_x, 1/m^2.
        velocity_weight: w_v, s^2/m^2.
        barrier_weight: w_b, 1/m^2.
        barrier: x_b, m.
    """

    horizon: float = 1.4
    dt: float = 0.01
    sample_time: float = 0.05
    control_weight: float = 0.03
    desired_change: float = -5.0
    largest_acceleration: float = 1.8
    largest_speed: float = 0.9
    time_exponent: float = 1.6
    first_duration: float = 0.2
    halvings: int = 8
    information_floor: float = 0.3
    position_weight: float = 2.0
    velocity_weight: float = 0.2
    barrier_weight: float = 500.0
    barrier: float = 0.18

    def __post_init__(self) -> None:
        positive = ("horizon", "dt", "sample_time", "control_weight", "largest_acceleration", "largest_speed")
        for name in (*positive, "first_duration", "information_floor"):
            if not getattr(self, name) > 0:
                raise InputError(f"SAC setting {name} = {getattr(self, name)}: it must be positive")
        if not self.desired_change < 0:
            raise InputError(
                f"SAC setting desired_change = {self.desired_change}: it must be negative to lower the cost"
            )

    @property
    def steps(self) -> int:
        """Integration steps of the horizon."""
        return round(self.horizon / self.dt)

    def weights(self) -> np.ndarray:
        """(5,) in the order of `SETTINGS`."""
        return np.array([getattr(self, name) for name in SETTINGS])


@dataclass(frozen=True)
class SacState:
    """Where the gripper and the load are, and how the load's state would change with the length.

    Attributes:
        time: s.
        x: gripper, m.
        v: gripper, m/s.
        pendulum: (2,) angle and momentum, see `dynamics`.
        sensitivity: (2,) its derivative with respect to the length.
    """

    time: float
    x: float
    v: float
    pendulum: np.ndarray
    sensitivity: np.ndarray

    def vector(self) -> np.ndarray:
        """(6,) extended state."""
        return np.concatenate([[self.x, self.v], self.pendulum, self.sensitivity])


@dataclass(frozen=True)
class SacAction:
    """One needle of acceleration.

    Attributes:
        acceleration: m/s^2.
        start: s after now.
        end: s after now.
        schedule: (steps,) acceleration held over each integration step of the horizon, m/s^2.
        cost: of the horizon with the action.
        free_cost: of the horizon without.
        seconds: spent deciding.
    """

    acceleration: float
    start: float
    end: float
    schedule: np.ndarray
    cost: float
    free_cost: float
    seconds: float


class SequentialActionControl:
    """Chooses actions for one composed model."""

    def __init__(self, model: PendulumModel, settings: SacSettings | None = None) -> None:
        self.settings = settings or SacSettings()
        self._names = model.physics_names
        self._cost, self._gradient = _functions(
            model.dynamics(), model.formulation, self.settings.steps, self.settings.dt
        )

    def act(self, state: SacState, model: PendulumModel) -> SacAction:
        """The action from now on.

        Args:
            state: of gripper and load, now.
            model: with the latest estimate; the same effects as the one this controller was built for.
        """
        started = perf_counter()
        if model.physics_names != self._names:
            raise InputError("this controller was built for a model with other effects: build a new one")
        c = self.settings
        fixed = (state.vector(), state.time, model.physics_theta(), c.weights())
        free = np.zeros(c.steps)
        cost, gradient = self._gradient(free, *fixed)
        free_cost, g = float(cost[0, 0]), gradient.ravel() / c.dt
        desired = c.desired_change * free_cost
        u2 = np.clip(g * desired / (g**2 + c.control_weight), -c.largest_acceleration, c.largest_acceleration)
        times = c.dt * (np.arange(c.steps) + 0.5)
        best = int(np.argmin(np.abs(u2) + u2 * g + times**c.time_exponent))
        middle, size = times[best], float(u2[best])
        duration = c.first_duration
        for _ in range(c.halvings + 1):
            start, end = max(0.0, middle - duration / 2), min(c.horizon, middle + duration / 2)
            schedule = self._within_speed(needle(size, start, end, c.steps, c.dt), state.v)
            tried = float(self._cost(schedule, *fixed)[0][0, 0])
            if tried < free_cost:
                return SacAction(size, start, end, schedule, tried, free_cost, perf_counter() - started)
            duration /= 2
        return SacAction(
            0.0, 0.0, 0.0, self._within_speed(free, state.v), free_cost, free_cost, perf_counter() - started
        )

    def gradient(self, schedule: np.ndarray, state: SacState, model: PendulumModel) -> tuple[float, np.ndarray]:
        """Cost of a schedule (steps,) of accelerations and its exact derivative (steps,)."""
        cost, gradient = self._gradient(
            schedule, state.vector(), state.time, model.physics_theta(), self.settings.weights()
        )
        return float(cost[0, 0]), gradient.ravel().copy()

    def _within_speed(self, schedule: np.ndarray, v: float) -> np.ndarray:
        limit, dt = self.settings.largest_speed, self.settings.dt
        kept = []
        for a in schedule.tolist():  # Python's own floats: numpy takes ten times as long for one number
            kept.append(min(max(a, (min(-limit, v) - v) / dt), (max(limit, v) - v) / dt))
            v += dt * kept[-1]
        return np.array(kept)


def needle(size: float, start: float, end: float, steps: int, dt: float) -> np.ndarray:
    """(steps,) acceleration `size` between `start` and `end` s, averaged over each step."""
    edges = dt * np.arange(steps + 1)
    overlap = np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0.0, dt)
    return size * overlap / dt


@lru_cache(maxsize=16)
def _functions(dynamics: Dynamics, name: str, steps: int, dt: float) -> tuple[Buffered, Buffered]:
    """Cost, and cost with gradient, of (schedule, extended state, time, theta, weights)."""
    parameters = len(dynamics.names)
    z, u, t = ca.SX.sym("z", EXTENDED), ca.SX.sym("u"), ca.SX.sym("t")
    theta, weights = ca.SX.sym("theta", parameters), ca.SX.sym("weights", len(SETTINGS))
    x, v, pendulum, psi = z[0], z[1], z[2 : 2 + STATE_SIZE], z[2 + STATE_SIZE :]
    w = ca.vertcat(t, x, v, u, ca.SX(3, 1))
    length = dynamics.names.index("length")

    def derivative(expression: ca.SX) -> ca.SX:
        """Total derivative with respect to the length."""
        return ca.jtimes(expression, pendulum, psi) + ca.jacobian(expression, theta)[:, length]

    rate = dynamics.derivative(pendulum, w, theta)
    extended = ca.Function("extended", [z, u, t, theta], [ca.vertcat(v, u, rate, derivative(rate))])
    k1 = extended(z, u, t, theta)
    k2 = extended(z + dt / 2 * k1, u, t + dt / 2, theta)
    k3 = extended(z + dt / 2 * k2, u, t + dt / 2, theta)
    k4 = extended(z + dt * k3, u, t + dt, theta)
    following = z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    gamma = derivative(dynamics.tension(pendulum, w, theta))
    floor, w_x, w_v, w_b, barrier = ca.vertsplit(weights)
    running = floor**2 / (gamma**2 + floor**2) + w_x * x**2 + w_v * v**2 + w_b * ca.fmax(0, ca.fabs(x) - barrier) ** 2
    J = ca.SX.sym("J")
    stage = ca.Function("stage", [z, J, u, t, theta, weights], [following, J + dt * running])
    co = ca.SX.sym("co", EXTENDED)
    back = ca.Function(
        "back",
        [co, z, u, t, theta, weights],
        [
            ca.densify(ca.jtimes(following, z, co, True) + dt * ca.gradient(running, z)),
            ca.jtimes(following, u, co, True) + dt * ca.gradient(running, u),
        ],
    )
    ahead, behind = stage.mapaccum("ahead", steps, 2), back.mapaccum("behind", steps)
    U, z0, t0 = ca.MX.sym("u", steps), ca.MX.sym("z0", EXTENDED), ca.MX.sym("t0")
    P, W = ca.MX.sym("theta", parameters), ca.MX.sym("weights", len(SETTINGS))
    T = t0 + dt * ca.DM(range(steps)).T
    repeated = (ca.repmat(P, 1, steps), ca.repmat(W, 1, steps))
    Z, cost = ahead(z0, 0, U.T, T, *repeated)
    before = ca.horzcat(z0, Z[:, :-1])
    flip = ca.Slice(steps - 1, -(steps + 1), -1)
    _, gradient = behind(ca.MX.zeros(EXTENDED), before[:, flip], U.T[:, flip], T[:, flip], *repeated)
    arguments = [U, z0, t0, P, W]
    built = compiled(
        f"sac_{name}",
        {
            "cost": ca.Function("cost", arguments, [cost[-1]]),
            "gradient": ca.Function("gradient", arguments, [cost[-1], gradient[:, flip].T]),
        },
    )
    return Buffered(built["cost"]), Buffered(built["gradient"])
