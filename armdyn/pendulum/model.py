"""The pendulum as a model: it predicts what a load cell and an angle sensor should have read in a run."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.optimize import brentq

from armdyn.effects.catalogue import catalogue_order
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.parameter import Parameter, Prior
from armdyn.pendulum.composition import PENDULUM_STAGES, Composition
from armdyn.pendulum.dynamics import PendulumDynamics, derive_dynamics
from armdyn.pendulum.path import GripperPath, run_path, trailing
from armdyn.pendulum.physics import GRAVITY_SPREAD, STANDARD_GRAVITY
from armdyn.pendulum.start import free_swing, phase_plane, pieces, rates_near, start_values, swing_shown
from armdyn.pendulum.variational import VariationalStep, derive_variational
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulated import (
    LOCAL_FIT_PERIODS,
    SimulatedModel,
    end_of_motion,
    local_motion,
    main_period,
    measured_start,
)
from armdyn.run import Channel, Run

KEYS = ()
"""Keys of a model file that belong to this base."""
START_PARAMETERS = ("initial_angle", "initial_rate")
GRIPPER_CHANNELS = ("gripper_x", "gripper_v", "gripper_a", "gripper_z")
MAX_SWING_PERIODS = 1.5
"""Longest period of a swing, in periods of small swings; the length may be a guess."""
MAX_REST_ANGLE = 1.5
"""Largest angle at which a load can hang at rest, rad."""


@dataclass(frozen=True, repr=False)
class PendulumModel(SimulatedModel):
    """A load on a string below a moving gripper, with any effects."""

    base = "pendulum"
    stages = PENDULUM_STAGES
    inputs = GRIPPER_CHANNELS
    start_names = START_PARAMETERS

    @property
    def forced(self) -> Mapping[int, str | None]:
        """Index of the start value that a force changes: the rate; see `SimulatedModel.forced`."""
        return {START_PARAMETERS.index("initial_rate"): None}

    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """Start values at (J,) times, from the measured angle, or else from the rate and its derivative."""
        length = float(theta[self.names.index("length")])
        if "swing_angle" in run.channels:
            motion = local_motion(run.channels["swing_angle"], times, LOCAL_FIT_PERIODS * swing)
        elif "swing_rate" in run.channels:
            rate = local_motion(run.channels["swing_rate"], times, LOCAL_FIT_PERIODS * swing)
            mean = float(np.mean(run.channels["swing_rate"].value))
            pace = 2.0 * np.pi / swing
            motion = np.column_stack([np.arcsin(np.clip(-rate[:, 1] / pace**2, -1.0, 1.0)), rate[:, 0] - mean])
        else:
            return None
        path = run_path(run)
        speed = np.interp(times, path.time, path.v)
        return np.column_stack([motion[:, 0], motion[:, 1] - speed / length * np.cos(motion[:, 0])])

    def force_covariates(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """Quantities on which a missing acceleration may depend; the load is the tension of a point mass."""
        del speed
        length, mass, gravity = (float(theta[self.names.index(name)]) for name in ("length", "mass", "gravity"))
        path = run_path(run)
        v, a = (np.interp(time, path.time, x) for x in (path.v, path.a))
        angle = motion[:, 0]
        rate = motion[:, 1] + v / length * np.cos(angle)
        pull = mass * (gravity * np.cos(angle) + length * rate**2 + a * np.sin(angle))
        found = {"speed": (rate, "rad/s"), "angle": (angle, "rad"), "load": (pull, "N")}
        return found | ({"pivot_acceleration": (a, "m/s^2")} if "gripper_x" in run.channels else {})

    def comes_to_rest(self, run: Run, swing: float) -> float:
        """Time at which a swing below a fixed pivot has come to rest, s; see `SimulatedModel.comes_to_rest`."""
        name = swing_shown(run)
        return np.inf if name is None or "gripper_x" in run.channels else end_of_motion(run.channels[name], swing)

    def direct_estimates(self, run: Run, theta: np.ndarray) -> dict[str, float]:
        """The length, nearly, from the period of a free swing; see `SimulatedModel.direct_estimates`."""
        if "gripper_x" in run.channels or swing_shown(run) is None:
            return {}
        return {"length": float(theta[self.names.index("gravity")]) * (self.swing(run, theta) / (2.0 * np.pi)) ** 2}

    def swing(self, run: Run, theta: np.ndarray) -> float:
        """Period of the swing, s; that of small swings where only a force was measured; see `SimulatedModel.swing`.

        A load that goes round and round has no period in its angle.
        """
        name, small = swing_shown(run), self.start_window(theta)
        return small if name is None else min(main_period(run.channels[name]), MAX_SWING_PERIODS * small)

    def guess_start_state(self, run: Run) -> Mapping[str, float]:
        """Start angle and rate, where an angle was measured; see `Model.guess_start_state`."""
        if "swing_angle" not in run.channels:
            return {}
        return start_values(run, self.value("length"), [measured_start(run.channels["swing_angle"])])[0]

    def possible_start_states(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start values to try: orbits in the phase plane, near the measured angle where there is one."""
        pace = 2.0 * np.pi / self.start_window(theta)
        plane = phase_plane(pace)
        if "swing_angle" in run.channels:
            angle, rate = measured_start(run.channels["swing_angle"])
            plane = np.array([(angle, rate + change) for change in rates_near(pace)])
        return start_values(run, float(theta[self.names.index("length")]), plane)

    def start_window(self, theta: np.ndarray) -> float:
        """Length of a run from which its start can be found, s: one period; see `Model.start_window`."""
        length, gravity = (theta[self.names.index(name)] for name in ("length", "gravity"))
        return float(2 * np.pi * np.sqrt(length / gravity))

    def split_into_pieces(self, run: Run) -> Sequence[Run]:
        """The run, cut at blind gaps of the gripper (`start.pieces`); below a fixed pivot its free swing."""
        return pieces(run) if "gripper_x" in run.channels else (free_swing(run, self.swing(run, self.theta())),)

    @property
    def hangs_from_gripper(self) -> bool:
        """See `Model.hangs_from_gripper`."""
        return True

    @cached_property
    def formulation(self) -> str:
        """Identifier of the equations; see `SimulatedModel.formulation`."""
        return "_".join(["pendulum", *(e.name for e in catalogue_order(self.effects))])

    def dynamics(self) -> PendulumDynamics:
        """Continuous equations with two states and four inputs, for sequential action control."""
        return _dynamics(catalogue_order(self.effects), planar=True)

    def variational(self) -> VariationalStep:
        """Discrete variational equations, for planning."""
        return _variational(catalogue_order(self.effects))

    def rest_angle(self) -> float:
        """Angle at which the load hangs at rest below a gripper at rest, rad: not 0 in wind or on a tilted line.

        Raises:
            InputError: it cannot hang at rest.
        """
        dynamics, theta, still = self.dynamics(), self.physics_theta(), np.zeros(7)

        def moment(angle: float) -> float:
            return float(dynamics.derivative(np.array([angle, 0.0]), still, theta)[1])

        if not moment(-MAX_REST_ANGLE) > 0.0 > moment(MAX_REST_ANGLE):
            raise InputError("the load of this model does not come to rest below the gripper: check its effects")
        return float(brentq(moment, -MAX_REST_ANGLE, MAX_REST_ANGLE, xtol=1e-12))

    def driven_by(self, path: InputPath, physics: np.ndarray) -> InputPath:
        """The path of the string's upper end, from the recorded path of the gripper; see `SimulatedModel`."""
        trails = self.system.input_lag is not None
        return super().driven_by(trailing(path, self.gripper_lag(physics)) if trails else path, physics)

    def gripper_lag(self, physics: np.ndarray) -> float:
        """Lag of the string's upper end behind the measured gripper, s; `physics` is (p,) as `physics_theta`."""
        return 0.0 if self.system.input_lag is None else float(self.system.input_lag(physics))

    def swing_at_the_end(self, path: GripperPath) -> tuple[float, float, float]:
        """Speed of the string's upper end, m/s, swing angle, rad, and rate, rad/s, at the end of a path."""
        physics, dynamics = self.physics_theta(), self.system
        state = self.rollout(path, self.theta(), channels=("load_force",)).states[-1]
        motion = self.driven_by(path, physics).nodes[: dynamics.inputs, -1]
        return float(motion[2]), float(state[0]), float(dynamics.rate(state, motion, physics))

    def path(self, run: Run) -> GripperPath:
        """The gripper's recorded path on an even grid; see `SimulatedModel.path`."""
        return run_path(run)

    def without_null_effects(self, values: Mapping[str, float]) -> "PendulumModel":
        """The model without the effects that change nothing at these values."""
        return self.with_only_effects({p.effect for name, p in self.parameters.items() if values[name] != p.null})

    @property
    def remembering(self) -> frozenset[str]:
        """Names of the effects that add states; see `SimulatedModel.remembering`."""
        return frozenset(effect.name for effect in self.effects if _brings(effect)[0])

    @property
    def slow(self) -> frozenset[str]:
        """Names of the effects that add states or inputs and make simulations slow; see `SimulatedModel.slow`."""
        return frozenset(effect.name for effect in self.effects if any(_brings(effect)))

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Predicted swing angle and rate, and the gripper's motion; see `Model.covariates`."""
        path = run_path(run)
        values = dict(zip(self.names, theta.tolist(), strict=True))
        reduced = self.without_null_effects(values)
        channels = ("swing_angle", "swing_rate")
        outputs = reduced.rollout(path, np.array([values[name] for name in reduced.names]), channels).outputs
        time = path.time
        found = {
            "swing_angle": Channel(time, outputs[:, 0], "rad"),
            "swing_rate": Channel(time, outputs[:, 1], "rad/s"),
        }
        if "gripper_x" in run.channels:
            found["gripper_x"] = Channel(time, path.x, "m")
            found["gripper_a"] = Channel(time, path.a, "m/s^2")
        return found

    @cached_property
    def system(self) -> PendulumDynamics:
        """The equations with their effects; see `SimulatedModel.system`."""
        return _dynamics(catalogue_order(self.effects))


@lru_cache(maxsize=128)
def _dynamics(effects: tuple[Effect, ...], *, planar: bool = False) -> PendulumDynamics:
    return derive_dynamics(Composition(effects), planar=planar)


@lru_cache(maxsize=256)
def _brings(effect: Effect) -> tuple[bool, bool]:
    """Whether an effect adds states, and whether it adds inputs."""
    with_it = Composition([effect])
    return with_it.crosses or with_it.remembers > 0, with_it.yields or with_it.trails


@lru_cache(maxsize=64)
def _variational(effects: tuple[Effect, ...]) -> VariationalStep:
    return derive_variational(Composition(effects))


def pendulum_model(length: float, mass: float, effects: Iterable[Effect] = ()) -> PendulumModel:
    """Build a pendulum with effects at their null values.

    Args:
        length: distance from the pivot to the load's centre, m.
        mass: mass of the load, kg.
        effects: effects of the model.

    Raises:
        InputError: the length or mass is physically impossible.
    """
    base = (
        Parameter("length", "m", length, 0.3, null=length, lower=0.02, upper=5.0, source="pivot to the load's centre"),
        Parameter("mass", "kg", mass, 0.1, null=mass, lower=1e-4, upper=50.0, source="of the load"),
        Parameter(
            "gravity", "m/s^2", STANDARD_GRAVITY, GRAVITY_SPREAD, null=STANDARD_GRAVITY, lower=1.0, upper=30.0,
            prior=Prior(STANDARD_GRAVITY, GRAVITY_SPREAD), fitted=False, source="of free fall, where it stands",
        ),
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


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[PendulumModel, dict[str, Any]]:
    """The model without effects, and further entries of the file that belong to the base."""
    del table, folder
    return pendulum_model(0.35, 0.1), {}
