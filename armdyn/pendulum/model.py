"""The pendulum as a model: what a load cell and an angle sensor should have read in a run."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.faults import without_saturation, without_spikes
from armdyn.model import Model, Prediction
from armdyn.parameter import Parameter
from armdyn.pendulum.composition import STAGES, STANDARD_GRAVITY, compose, natural_order
from armdyn.pendulum.dynamics import OUTPUTS, Dynamics, TensionFormula, derive_dynamics
from armdyn.pendulum.path import GripperPath
from armdyn.pendulum.physics import Expression
from armdyn.pendulum.pieces import pieces
from armdyn.pendulum.readout import lagged, sampled
from armdyn.pendulum.recorded import run_path
from armdyn.pendulum.simulate import Rollout, Simulator
from armdyn.pendulum.starts import phase_plane, rates_near
from armdyn.pendulum.trailing import TrailingPath
from armdyn.pendulum.variational import VariationalStep, derive_variational
from armdyn.run import Channel, Run
from armdyn.thinning import thinned

FIRST_STRETCH, FIRST_SAMPLES = 0.1, 5
"""s, and at least as many samples, through which a parabola gives the angle and rate at the start."""
INITIAL = ("initial_angle", "initial_rate")
STEEPEST = 1.5
"""rad; no load hangs at rest beyond."""


@dataclass(frozen=True)
class PendulumModel(Model):
    """A load on a string below a moving gripper.

    Attributes:
        tension: ``"exact"``, or ``"printed"`` for the formula in the paper, which is wrong.
    """

    tension: TensionFormula = "exact"

    base = "pendulum"
    first_window = 0.75
    stages = STAGES

    @cached_property
    def physics_names(self) -> tuple[str, ...]:
        """Parameters of the equations of motion and of the sensors, in the order of theta there."""
        return self._formulation.names

    @cached_property
    def formulation(self) -> str:
        """Identifier of the equations: two models that share it differ in numbers only."""
        return "_".join([self.tension, *(e.name for e in natural_order(self.effects))])

    def physics_theta(self) -> np.ndarray:
        """(p,) present values in the order of `physics_names`."""
        return np.array([self.parameters[name].value for name in self.physics_names])

    def dynamics(self) -> Dynamics:
        """Continuous equations with two states and four inputs, for sequential action control."""
        return _planar(natural_order(self.effects), self.tension)

    def variational(self) -> VariationalStep:
        """Discrete variational equations, for planning."""
        return _variational(natural_order(self.effects))

    def rest_angle(self) -> float:
        """Angle at which the load hangs at rest below a gripper at rest, rad: not 0 in wind or on a tilted line.

        Raises:
            InputError: it cannot hang at rest.
        """
        dynamics, theta, still = self.dynamics(), self.physics_theta(), np.zeros(7)

        def moment(angle: float) -> float:
            return float(dynamics.derivative(np.array([angle, 0.0]), still, theta)[1])

        if not moment(-STEEPEST) > 0.0 > moment(STEEPEST):
            raise InputError("the load of this model does not come to rest below the gripper: check its effects")
        return float(brentq(moment, -STEEPEST, STEEPEST, xtol=1e-12))

    def rollout(self, path: GripperPath, theta: np.ndarray, channels: tuple[str, ...] = OUTPUTS) -> Rollout:
        """Simulate `channels` along a gripper path; `theta` (p,) in the order of `names`."""
        physics = theta[self._order[1]]
        initial = [float(theta[self.names.index(name)]) for name in INITIAL]
        formulation = self._formulation
        simulator = _simulator(formulation.dynamics, self.formulation, channels, formulation.trails)
        return simulator.rollout(self._hung_from(path, physics), physics, *initial)

    def _hung_from(self, path: GripperPath, physics: np.ndarray) -> GripperPath | TrailingPath:
        return TrailingPath(path, self.gripper_lag(physics)) if self._formulation.trails else path

    def gripper_lag(self, physics: np.ndarray) -> float:
        """Time by which the string's upper end trails the measured gripper, s; `physics` as `physics_theta`."""
        return float(self._formulation.timing(physics)[0][2])

    def swing_at_the_end(self, path: GripperPath) -> tuple[float, float, float]:
        """Speed of the string's upper end (m/s), angle (rad) and rate (rad/s) after a path, with the present values."""
        physics, dynamics = self.physics_theta(), self._formulation.dynamics
        state = self.rollout(path, self.theta(), channels=("load_force",)).states[-1]
        hung_from = self._hung_from(path, physics)
        motion = np.append(hung_from.inputs[0][:, -1], hung_from.jerk[0][0, -1])[: dynamics.inputs]
        return float(motion[2]), float(state[0]), float(dynamics.rate(state, motion, physics))

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """See `Model.predicted_channels`."""
        channels = tuple(name for name in OUTPUTS if name in run.channels)
        if not channels:
            raise InputError(f"{run.name}: holds none of {', '.join(OUTPUTS)}, so there is nothing to compare")
        return channels

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """See `Model.predict`; predicted are load_force, swing_angle and swing_rate."""
        channels = self.predicted_channels(run)
        path = run_path(run)
        rollout = self.rollout(path, theta, channels)
        columns, places = self._order
        physics = theta[places]
        blocks, slices, stamps, first = [], {}, [], 0
        for name in channels:
            row = channels.index(name)
            time = run.channels[name].time
            signal = np.column_stack([rollout.outputs[:, row], rollout.sensitivities[:, row]])
            if name == "load_force":
                block = self._read_force(signal, time, path, physics)
            else:
                block = sampled(signal, (time - path.start) / path.dt)[0]
            blocks.append(block)
            stamps.append(time)
            slices[name] = slice(first, first + len(time))
            first += len(time)
        joined = np.concatenate(blocks)
        return Prediction(channels, slices, np.concatenate(stamps), joined[:, 0], joined[:, 1:][:, columns])

    def without_null_effects(self, values: Mapping[str, float]) -> "PendulumModel":
        """The model without the effects that change nothing at these values."""
        return self.with_only({p.effect for name, p in self.parameters.items() if values[name] != p.null})

    def holding(self, needed: Collection[str]) -> "PendulumModel":
        """See `Model.holding`; what swings across the line costs most, then what gives way or trails."""
        present = {effect: _burden(effect) for effect in self.effects}
        worst = max((burden for effect, burden in present.items() if effect.name in needed), default=None)
        kept = [effect for effect, burden in present.items() if worst is not None and burden <= worst]
        if len(kept) == len(self.effects):
            return self
        return self.with_only({effect.name for effect in kept})

    def prepared(self, run: Run) -> Run:
        """See `Model.prepared`."""
        names = self.predicted_channels(run)
        return without_spikes(thinned(without_saturation(run, names)), names)

    def pieces(self, run: Run) -> Sequence[Run]:
        """See `Model.pieces`."""
        return pieces(run)

    def corrected(self) -> "PendulumModel | None":
        """With the exact tension where it has the printed one; see `Model.corrected`."""
        return replace(self, tension="exact") if self.tension == "printed" else None

    def initial_guess(self, run: Run) -> Mapping[str, float]:
        """Angle and rate at the start where an angle was measured; see `Model.initial_guess`."""
        if "swing_angle" not in run.channels:
            return {}
        angle, rate = _measured_start(run.channels["swing_angle"])
        speed = float(run_path(run).v[0]) / self.value("length")
        return {"initial_angle": angle, "initial_rate": rate - speed * float(np.cos(angle))}

    def plausible_starts(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """See `Model.plausible_starts`: orbits in the phase plane, near the measured angle where there is one."""
        length = float(theta[self.names.index("length")])
        plane = phase_plane(length)
        if "swing_angle" in run.channels:
            angle, rate = _measured_start(run.channels["swing_angle"])
            plane = np.array([(angle, rate + change) for change in rates_near(length)])
        speed = float(run_path(run).v[0]) / length
        return [
            {"initial_angle": float(angle), "initial_rate": float(rate - speed * np.cos(angle))}
            for angle, rate in plane
        ]

    def first_stretch(self, theta: np.ndarray) -> float:
        """A period of small swings; see `Model.first_stretch`."""
        return float(2 * np.pi * np.sqrt(theta[self.names.index("length")] / STANDARD_GRAVITY))

    def circumstances(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Swing angle and rate as predicted, and the gripper's motion; see `Model.circumstances`."""
        path = run_path(run)
        values = dict(zip(self.names, theta.tolist(), strict=True))
        lean = self.without_null_effects(values)
        channels = ("swing_angle", "swing_rate")
        outputs = lean.rollout(path, np.array([values[name] for name in lean.names]), channels).outputs
        time = np.asarray(path.start + path.dt * np.arange(len(path.x)), dtype=np.float64)
        found = {
            "swing_angle": Channel(time, outputs[:, 0], "rad"),
            "swing_rate": Channel(time, outputs[:, 1], "rad/s"),
        }
        if "gripper_x" in run.channels:
            found["gripper_x"] = Channel(time, path.x, "m")
            found["gripper_a"] = Channel(time, path.a, "m/s^2")
        return found

    def _read_force(self, signal: np.ndarray, time: np.ndarray, path: GripperPath, physics: np.ndarray) -> np.ndarray:
        """(n, 1 + p) of the load cell: signal and derivatives through lag and delay, to the sample times."""
        lags, delays = self._formulation.lags, self._formulation.delays
        if not (lags or delays):
            return sampled(signal, (time - path.start) / path.dt)[0]
        timing, derivative = (np.asarray(a) for a in self._formulation.timing(physics))
        lag, delay, _ = timing.ravel()
        if lags:
            signal, per_lag = lagged(signal, float(lag), path.dt)
            for column in lags:
                signal[:, 1 + column] += per_lag * derivative[0, column]
        block, per_step = sampled(signal, (time - delay - path.start) / path.dt)
        for column in delays:
            block[:, 1 + column] -= per_step / path.dt * derivative[1, column]
        return block

    @cached_property
    def _order(self) -> tuple[list[int], list[int]]:
        """Where the columns of a rollout are among `names`, and where the physics' parameters are."""
        rollout = (*self.physics_names, *INITIAL)
        return [rollout.index(name) for name in self.names], [self.names.index(name) for name in self.physics_names]

    @cached_property
    def _formulation(self) -> "_Formulation":
        return _formulation(natural_order(self.effects), self.tension)


def _measured_start(angle: Channel) -> tuple[float, float]:
    """Angle and rate at the first sample, by a parabola through the first ones."""
    since = angle.time - angle.time[0]
    near = max(FIRST_SAMPLES, int(np.searchsorted(since, FIRST_STRETCH)))
    curve = np.polyfit(since[:near], angle.value[:near], 2)
    return float(curve[2]), float(curve[1])


@dataclass(frozen=True)
class _Formulation:
    """What is derived and compiled once per set of effects; lags and delays are the parameters they depend on."""

    names: tuple[str, ...]
    dynamics: Dynamics
    timing: ca.Function
    lags: tuple[int, ...]
    delays: tuple[int, ...]
    trails: bool


@lru_cache(maxsize=64)
def _formulation(effects: tuple[Effect, ...], tension: TensionFormula) -> _Formulation:
    composition = compose(effects)
    dynamics = derive_dynamics(composition, tension)
    theta = ca.SX.sym("theta", len(dynamics.names))
    timing = ca.vertcat(*dynamics.timing(theta))
    derivative = ca.densify(ca.jacobian(timing, theta))
    return _Formulation(
        names=dynamics.names,
        dynamics=dynamics,
        timing=ca.Function("timing", [theta], [ca.densify(timing), derivative]),
        lags=_dependent(timing[0], theta),
        delays=_dependent(timing[1], theta),
        trails=composition.trails,
    )


def _dependent(expression: Expression, theta: Expression) -> tuple[int, ...]:
    return tuple(i for i, depends in enumerate(ca.which_depends(expression, theta, 1, False)) if depends)


@lru_cache(maxsize=256)
def _burden(effect: Effect) -> int:
    """How much an effect adds to every step of a simulation: 2 for further states, 1 for further inputs, else 0."""
    composition = compose([effect])
    return 2 if composition.crosses else int(composition.yields or composition.trails)


@lru_cache(maxsize=64)
def _simulator(dynamics: Dynamics, name: str, channels: tuple[str, ...], trails: bool) -> Simulator:
    return Simulator(dynamics, name, channels, trails=trails)


@lru_cache(maxsize=64)
def _planar(effects: tuple[Effect, ...], tension: TensionFormula) -> Dynamics:
    return derive_dynamics(compose(effects), tension, planar=True)


@lru_cache(maxsize=64)
def _variational(effects: tuple[Effect, ...]) -> VariationalStep:
    return derive_variational(compose(effects))


def pendulum_model(
    length: float, mass: float, effects: Iterable[Effect] = (), *, tension: TensionFormula = "exact"
) -> PendulumModel:
    """A pendulum with effects at their null values.

    Args:
        length: pivot to the load's centre, m.
        mass: of the load, kg.
        effects: to start with.
        tension: see `PendulumModel`.

    Raises:
        InputError: a length or mass that no pendulum has.
    """
    base = (
        Parameter("length", "m", length, 0.3, null=length, lower=0.02, upper=5.0, source="pivot to the load's centre"),
        Parameter("mass", "kg", mass, 0.1, null=mass, lower=1e-4, upper=50.0, source="of the load"),
        Parameter("initial_angle", "rad", 0.0, 0.1, lower=-3.2, upper=3.2, scope="per_run"),
        Parameter(
            "initial_rate", "rad/s", 0.0, 0.5, lower=-30.0, upper=30.0, scope="per_run",
            source="swing rate seen from rest in space: phi' - (v/l) cos(phi)",
        ),
    )  # fmt: skip
    empty: Mapping[str, Parameter] = MappingProxyType({p.name: p for p in base})
    model = PendulumModel(effects=(), parameters=empty, tension=tension)
    for item in effects:
        model = model.with_effect(item)
    return model
