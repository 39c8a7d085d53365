"""The pendulum as a model: what a load cell and an angle sensor should have read in a run."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path as File
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from armdyn.effects.effect import Effect
from armdyn.effects.tension import printed_tension
from armdyn.errors import InputError, UnknownNameError
from armdyn.parameter import Parameter
from armdyn.pendulum.composition import STAGES, compose, natural_order
from armdyn.pendulum.dynamics import OUTPUTS, Dynamics, derive_dynamics
from armdyn.pendulum.path import GripperPath
from armdyn.pendulum.physics import STANDARD_GRAVITY
from armdyn.pendulum.pieces import pieces
from armdyn.pendulum.recorded import run_path
from armdyn.pendulum.starts import phase_plane, rates_near
from armdyn.pendulum.trailing import TrailingPath
from armdyn.pendulum.variational import VariationalStep, derive_variational
from armdyn.physics.readout import SensorChain
from armdyn.physics.simulate import Rollout, Simulator
from armdyn.physics.simulated import SimulatedModel, measured_start
from armdyn.run import Channel, Run

KEYS = ("tension",)
"""Keys of a model file that belong to this base."""
INITIAL = ("initial_angle", "initial_rate")
GRIPPER = ("gripper_x", "gripper_v", "gripper_a", "gripper_z")
STEEPEST = 1.5
"""rad; no load hangs at rest beyond."""


@dataclass(frozen=True)
class PendulumModel(SimulatedModel):
    """A load on a string below a moving gripper."""

    base = "pendulum"
    stages = STAGES
    outputs = OUTPUTS
    inputs = GRIPPER
    start_names = INITIAL
    first_window = 0.75

    @cached_property
    def physics_names(self) -> tuple[str, ...]:
        """Parameters of the equations of motion and of the sensors, in the order of theta there."""
        return self._formulation.names

    @cached_property
    def formulation(self) -> str:
        """Identifier of the equations: two models that share it differ in numbers only."""
        return "_".join(["pendulum", *(e.name for e in natural_order(self.effects))])

    def dynamics(self) -> Dynamics:
        """Continuous equations with two states and four inputs, for sequential action control."""
        return _planar(natural_order(self.effects))

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
        formulation = self._formulation
        simulator = _simulator(formulation.dynamics, self.formulation, channels)
        return simulator.rollout(self._hung_from(path, physics), physics, *self._start(theta))

    def _hung_from(self, path: GripperPath, physics: np.ndarray) -> GripperPath | TrailingPath:
        return path if self._formulation.dynamics.input_lag is None else TrailingPath(path, self.gripper_lag(physics))

    def gripper_lag(self, physics: np.ndarray) -> float:
        """Time by which the string's upper end trails the measured gripper, s; `physics` as `physics_theta`."""
        return float(self._formulation.dynamics.timing(physics)[2])

    def swing_at_the_end(self, path: GripperPath) -> tuple[float, float, float]:
        """Speed of the string's upper end (m/s), angle (rad) and rate (rad/s) after a path, with the present values."""
        physics, dynamics = self.physics_theta(), self._formulation.dynamics
        state = self.rollout(path, self.theta(), channels=("load_force",)).states[-1]
        hung_from = self._hung_from(path, physics)
        motion = np.append(hung_from.inputs[0][:, -1], hung_from.jerk[0][0, -1])[: dynamics.inputs]
        return float(motion[2]), float(state[0]), float(dynamics.rate(state, motion, physics))

    def path(self, run: Run) -> GripperPath:
        """See `SimulatedModel`."""
        return run_path(run)

    @property
    def chain(self) -> SensorChain:
        """Lag and delay of the load cell."""
        return self._formulation.chain

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

    def pieces(self, run: Run) -> Sequence[Run]:
        """See `Model.pieces`."""
        return pieces(run)

    def described(self, folder: File) -> Mapping[str, Any]:
        """See `Model.described`."""
        printed = printed_tension in self.effects
        return {**super().described(folder), **({"tension": "printed"} if printed else {})}

    def initial_guess(self, run: Run) -> Mapping[str, float]:
        """Angle and rate at the start where an angle was measured; see `Model.initial_guess`."""
        if "swing_angle" not in run.channels:
            return {}
        angle, rate = measured_start(run.channels["swing_angle"])
        speed = float(run_path(run).v[0]) / self.value("length")
        return {"initial_angle": angle, "initial_rate": rate - speed * float(np.cos(angle))}

    def plausible_starts(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """See `Model.plausible_starts`: orbits in the phase plane, near the measured angle where there is one."""
        length = float(theta[self.names.index("length")])
        plane = phase_plane(length)
        if "swing_angle" in run.channels:
            angle, rate = measured_start(run.channels["swing_angle"])
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

    @cached_property
    def _formulation(self) -> "_Formulation":
        return _formulation(natural_order(self.effects))


@dataclass(frozen=True)
class _Formulation:
    """What is derived and compiled once per set of effects."""

    names: tuple[str, ...]
    dynamics: Dynamics
    chain: SensorChain


@lru_cache(maxsize=64)
def _formulation(effects: tuple[Effect, ...]) -> _Formulation:
    composition = compose(effects)
    dynamics = derive_dynamics(composition)
    theta = ca.SX.sym("theta", len(dynamics.names))
    lag, delay, _ = dynamics.timing(theta)
    timing = ca.vertcat(ca.horzcat(lag, delay), ca.SX(len(OUTPUTS) - 1, 2))  # of the load cell only
    return _Formulation(
        names=dynamics.names,
        dynamics=dynamics,
        chain=SensorChain(OUTPUTS, timing, theta),
    )


@lru_cache(maxsize=256)
def _burden(effect: Effect) -> int:
    """How much an effect adds to every step of a simulation: 2 for further states, 1 for further inputs, else 0."""
    composition = compose([effect])
    if composition.crosses or composition.remembers:
        return 2
    return int(composition.yields or composition.gripper_lag is not None)


@lru_cache(maxsize=64)
def _simulator(dynamics: Dynamics, name: str, channels: tuple[str, ...]) -> Simulator:
    return Simulator(dynamics, name, channels)


@lru_cache(maxsize=64)
def _planar(effects: tuple[Effect, ...]) -> Dynamics:
    return derive_dynamics(compose(effects), planar=True)


@lru_cache(maxsize=64)
def _variational(effects: tuple[Effect, ...]) -> VariationalStep:
    return derive_variational(compose(effects))


def pendulum_model(length: float, mass: float, effects: Iterable[Effect] = ()) -> PendulumModel:
    """A pendulum with effects at their null values.

    Args:
        length: pivot to the load's centre, m.
        mass: of the load, kg.
        effects: to start with.

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
    model = PendulumModel(effects=(), parameters=empty)
    for item in effects:
        model = model.with_effect(item)
    return model


def read_base(table: Mapping[str, Any], folder: File) -> tuple[PendulumModel, dict[str, Any]]:
    """The model without effects, and what else of the file belongs to the base.

    Raises:
        UnknownNameError: there is no such formula of the tension.
    """
    del folder
    tension = table.get("tension", "exact")
    if tension not in ("exact", "printed"):
        raise UnknownNameError("tension formula", str(tension), ("exact", "printed"))
    return pendulum_model(0.35, 0.1, [printed_tension] if tension == "printed" else []), {}
