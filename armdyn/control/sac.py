r"""Sequential Action Control (SAC): short pulses of gripper acceleration that make the load cell informative.

The extended state holds the gripper (x, v), one or two pendulums (phi, P) and psi = d(phi, P)/dtheta for the parameters
in question. The information of the load cell on them is in signals g(t), see `questions`. The cost over the horizon is

    J = sum dt [ rho(g) + w_x x^2 + w_v v^2 + w_b max(0, |x| - x_b)^2 ] + f(G),      G = G_0 + sum dt g g' / s^2 .

For the length alone g = Gamma = dT/d(length) and rho = G0^2 / (Gamma^2 + G0^2), f = 0; for several parameters, or
rival models, rho = 0 and f is a criterion of the Gram matrix G, in which G_0 is what is known already. Its slope
F = df/dG at the end of the horizon makes f a running cost g' F g for the derivatives, which are exact.

One action is found in closed form from the first-order effect of a needle (mode insertion gradient) u2 g, g = dJ/du
per unit time along the free motion:  u2 = g alpha_d / (g^2 + R), alpha_d = gamma J. Its time minimises
|u2| + u2 g + (t - t0)^beta, its duration is the longest that lowers the cost.
(Ansari & Murphey, IEEE T-RO 2016; Wilson et al., IEEE T-ASE 2016. G0, the floor, is ours: at rest Gamma = 0. Where the
cost is a logarithm, gamma itself is the desired change.)

Gamma crosses zero within milliseconds, so the gradient is that of the discretised cost, by reverse differentiation.
"""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from armdyn.control.horizon import SAC_WEIGHTS, horizon_functions
from armdyn.control.questions import LENGTH_OBJECTIVE, MotionObjective
from armdyn.errors import InputError
from armdyn.pendulum.model import PendulumModel


@dataclass(frozen=True)
class SacSettings:
    """Weights and limits of sequential action control; the defaults suit a gripper line of Baxter.

    Attributes:
        horizon: length of the horizon, s.
        dt: integration step, s.
        sample_time: interval at which an action is chosen, s.
        control_weight: weight R of the control, 1/(m/s^2)^2.
        desired_change: gamma < 0, the desired relative change of the cost.
        largest_acceleration: largest acceleration of the gripper, m/s^2.
        largest_speed: largest speed of the gripper, m/s; actions that would exceed it are cut.
        time_exponent: beta, the exponent of the penalty on later actions.
        first_duration: first duration of a pulse, s; it is halved until the cost falls.
        halvings: largest number of halvings.
        information_floor: G0, N/m; a floor on |Gamma|.
        position_weight: w_x, 1/m^2.
        velocity_weight: w_v, s^2/m^2.
        barrier_weight: w_b, 1/m^2.
        barrier: x_b, m.
        noise: density s of the load cell's noise, N s^(1/2): standard deviation of a sample over the root of the
            sampling rate.
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
    noise: float = 5e-4

    def __post_init__(self) -> None:
        positive = ("horizon", "dt", "sample_time", "control_weight", "largest_acceleration", "largest_speed")
        for name in (*positive, "first_duration", "information_floor", "noise"):
            if not getattr(self, name) > 0:
                raise InputError(f"SAC setting {name} = {getattr(self, name)}: it must be positive")
        if not self.desired_change < 0:
            raise InputError(
                f"SAC setting desired_change = {self.desired_change}: it must be negative to lower the cost"
            )

    @property
    def steps(self) -> int:
        """Number of integration steps in the horizon."""
        return round(self.horizon / self.dt)

    def weights(self) -> np.ndarray:
        """(5,) weights of the cost in the order of `SAC_WEIGHTS`."""
        return np.array([getattr(self, name) for name in SAC_WEIGHTS])


@dataclass(frozen=True)
class SacState:
    """State of gripper and load at which an action is chosen, with derivatives of the load's state by the parameters.

    Attributes:
        time: time, s.
        x: position of the gripper, m.
        v: velocity of the gripper, m/s.
        pendulum: (2,) angle and momentum, see `dynamics`.
        sensitivity: (2,) derivative of `pendulum` with respect to the length, or (2, m) with respect to m parameters;
            (2, 0) for a hypothesis that is compared with a rival.
        rival: (2,) angle and momentum of the rival's load; None without a rival.
        rival_sensitivity: (2, m) derivative of `rival` with respect to the rival's m unknowns.
        gram: (k, k) Gram matrix G_0 of the k signals so far; None for the objective of the length alone.
    """

    time: float
    x: float
    v: float
    pendulum: np.ndarray
    sensitivity: np.ndarray
    rival: np.ndarray | None = None
    rival_sensitivity: np.ndarray | None = None
    gram: np.ndarray | None = None

    def vector(self) -> np.ndarray:
        """(n,) states and their derivatives in one vector; n = 6 if only the length is estimated."""
        parts = [np.array([self.x, self.v]), self.pendulum, self.sensitivity.ravel(order="F")]
        if self.rival is not None and self.rival_sensitivity is not None:
            parts += [self.rival, self.rival_sensitivity.ravel(order="F")]
        return np.concatenate(parts)


@dataclass(frozen=True)
class SacAction:
    """An action of SAC: a pulse of acceleration.

    Attributes:
        acceleration: acceleration of the gripper, m/s^2.
        start: start of the pulse, s from now.
        end: end of the pulse, s from now.
        schedule: (steps,) acceleration in each integration step of the horizon, m/s^2.
        cost: cost of the horizon with the action.
        seconds: computing time, s.
    """

    acceleration: float
    start: float
    end: float
    schedule: np.ndarray
    cost: float
    seconds: float


class SequentialActionControl:
    """Chooses accelerations of the gripper that give information on a model, or distinguish two rival models.

    Args:
        model: model whose parameters are to be determined, or the hypothesis.
        settings: weights and limits.
        question: objective of the motion; by default to determine the length.
        rival: rival of the hypothesis, for an objective that distinguishes models.
    """

    def __init__(
        self,
        model: PendulumModel,
        settings: SacSettings | None = None,
        question: MotionObjective = LENGTH_OBJECTIVE,
        rival: PendulumModel | None = None,
    ) -> None:
        self.settings, self.question = settings or SacSettings(), question
        if question.rivals != (rival is not None):
            raise InputError("a question about rivals needs two models, and every other question one")
        models = [model] if rival is None else [model, rival]
        self._names = tuple(m.physics_names for m in models)
        question.check(models)
        known = models[-1].parameters
        self._scales = np.array([known[name].typical for name in question.parameters])
        self._cost, self._gradient = horizon_functions(
            tuple(m.dynamics() for m in models),
            "_against_".join(m.formulation for m in models),
            question,
            self.settings.steps,
            self.settings.dt,
        )

    def act(self, state: SacState, model: PendulumModel, rival: PendulumModel | None = None) -> SacAction:
        """Choose the next action.

        Args:
            state: present state of gripper and load.
            model: model with the latest estimate, and the same effects as the one this controller was built for.
            rival: rival model with its latest values, and the same effects as the one this controller was built for.
        """
        started = perf_counter()
        c = self.settings
        fixed = self._fixed(state, model, rival)
        free = np.zeros(c.steps)
        cost, gradient = self._gradient(free, *fixed)
        free_cost, g = float(cost[0, 0]), gradient.ravel() / c.dt
        desired = c.desired_change * (1.0 if self.question.logarithmic else free_cost)
        u2 = np.clip(g * desired / (g**2 + c.control_weight), -c.largest_acceleration, c.largest_acceleration)
        times = c.dt * (np.arange(c.steps) + 0.5)
        best = int(np.argmin(np.abs(u2) + u2 * g + times**c.time_exponent))
        middle, size = times[best], float(u2[best])
        duration = c.first_duration
        for _ in range(c.halvings + 1):
            start, end = max(0.0, middle - duration / 2), min(c.horizon, middle + duration / 2)
            schedule = self._within_speed(acceleration_pulse(size, start, end, c.steps, c.dt), state.v)
            tried = float(self._cost(schedule, *fixed)[0][0, 0])
            if tried < free_cost:
                return SacAction(size, start, end, schedule, tried, perf_counter() - started)
            duration /= 2
        return SacAction(0.0, 0.0, 0.0, self._within_speed(free, state.v), free_cost, perf_counter() - started)

    def _fixed(self, state: SacState, model: PendulumModel, rival: PendulumModel | None) -> tuple[object, ...]:
        """Arguments of the compiled functions after the schedule."""
        models = [model] if rival is None else [model, rival]
        if tuple(m.physics_names for m in models) != self._names:
            raise InputError("this controller was built for a model with other effects: build a new one")
        theta = models[0].physics_theta() if rival is None else np.concatenate([m.physics_theta() for m in models])
        gram = state.gram if self.question.logarithmic else np.zeros((0, 0))
        if gram is None:
            raise InputError("this question needs to know what is known already: give the state's gram")
        scales = np.append(self._scales, self.settings.noise)
        return state.vector(), state.time, theta, self.settings.weights(), scales, gram

    def _within_speed(self, schedule: np.ndarray, v: float) -> np.ndarray:
        limit, dt = self.settings.largest_speed, self.settings.dt
        kept = []
        for a in schedule.tolist():  # Python's own floats: numpy takes ten times as long for one number
            kept.append(min(max(a, (min(-limit, v) - v) / dt), (max(limit, v) - v) / dt))
            v += dt * kept[-1]
        return np.array(kept)


def acceleration_pulse(size: float, start: float, end: float, steps: int, dt: float) -> np.ndarray:
    """(steps,) acceleration in each step of `dt` s, for a pulse of `size`, m/s^2, from `start` to `end`, s."""
    edges = dt * np.arange(steps + 1)
    overlap = np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0.0, dt)
    return size * overlap / dt
