"""The model of a load on a string: it predicts the readings of a load cell, an angle sensor and a rate sensor."""

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
from armdyn.pendulum.composition import PENDULUM_STAGES, PendulumComposition
from armdyn.pendulum.dynamics import PendulumDynamics, derive_dynamics
from armdyn.pendulum.path import GripperPath, gripper_path, lagged_path
from armdyn.pendulum.physics import GRAVITY_STD, STANDARD_GRAVITY
from armdyn.pendulum.start import (
    cut_at_gripper_gaps,
    free_swing_part,
    possible_rate_errors,
    possible_start_states,
    start_parameters,
    swing_channel,
)
from armdyn.pendulum.variational import VariationalStep, derive_variational
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulated import (
    LOCAL_FIT_HALF_WIDTH_PERIODS,
    SimulatedModel,
    dominant_period,
    first_value_and_rate,
    local_values_and_rates,
    rest_time,
)
from armdyn.run import Channel, Run

KEYS = ()
"""Keys of a model file that belong to the base `pendulum`: none."""
START_PARAMETERS = ("initial_angle", "initial_rate")
GRIPPER_CHANNELS = ("gripper_x", "gripper_v", "gripper_a", "gripper_z")
MAX_MEASURED_TO_MODEL_PERIOD_RATIO = 1.5
"""Largest period of a measured swing, in periods of small swings of the model, whose length may be a guess."""
MAX_REST_SWING_ANGLE_RADIANS = 1.5
"""Largest swing angle at which a load can hang at rest, rad."""


@dataclass(frozen=True, repr=False)
class PendulumModel(SimulatedModel):
    """A load on a string below a moving gripper, with any effects."""

    base = "pendulum"
    stages = PENDULUM_STAGES
    inputs = GRIPPER_CHANNELS
    start_names = START_PARAMETERS

    @property
    def speed_states(self) -> Mapping[int, str | None]:
        """Index of the start value that a force changes: the swing rate."""
        return {START_PARAMETERS.index("initial_rate"): None}

    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """(J, 2) angles and rates at (J,) times, s, from the measured angle or rate; None if neither was measured."""
        length = float(theta[self.names.index("length")])
        if "swing_angle" in run.channels:
            motion = local_values_and_rates(run.channels["swing_angle"], times, LOCAL_FIT_HALF_WIDTH_PERIODS * swing)
        elif "swing_rate" in run.channels:
            rate = local_values_and_rates(run.channels["swing_rate"], times, LOCAL_FIT_HALF_WIDTH_PERIODS * swing)
            mean = float(np.mean(run.channels["swing_rate"].value))
            pace = 2.0 * np.pi / swing
            motion = np.column_stack([np.arcsin(np.clip(-rate[:, 1] / pace**2, -1.0, 1.0)), rate[:, 0] - mean])
        else:
            return None
        path = gripper_path(run)
        speed = np.interp(times, path.time, path.v)
        return np.column_stack([motion[:, 0], motion[:, 1] - speed / length * np.cos(motion[:, 0])])

    def force_covariates(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """(J,) values and unit of each quantity on which a missing acceleration may depend, by name.

        `motion` has the states (J, n) at the times (J,) `time`; `speed` is the index of the speed among the states
        whose derivative lacks a force; `theta` are the parameters. The quantity `load` is the tension of a point mass.
        """
        del speed
        length, mass, gravity = (float(theta[self.names.index(name)]) for name in ("length", "mass", "gravity"))
        path = gripper_path(run)
        v, a = (np.interp(time, path.time, x) for x in (path.v, path.a))
        angle = motion[:, 0]
        rate = motion[:, 1] + v / length * np.cos(angle)
        pull = mass * (gravity * np.cos(angle) + length * rate**2 + a * np.sin(angle))
        found = {"speed": (rate, "rad/s"), "angle": (angle, "rad"), "load": (pull, "N")}
        return found | ({"pivot_acceleration": (a, "m/s^2")} if "gripper_x" in run.channels else {})

    def time_of_rest(self, run: Run, swing: float) -> float:
        """Time at which a swing below a fixed pivot has come to rest, s; infinite below a moving gripper."""
        name = swing_channel(run)
        return np.inf if name is None or "gripper_x" in run.channels else rest_time(run.channels[name], swing)

    def direct_estimates(self, run: Run, theta: np.ndarray) -> dict[str, float]:
        """Approximate length of the string from the period of a free swing; empty without a free swing."""
        if "gripper_x" in run.channels or swing_channel(run) is None:
            return {}
        return {
            "length": float(theta[self.names.index("gravity")])
            * (self.oscillation_period(run, theta) / (2.0 * np.pi)) ** 2
        }

    def oscillation_period(self, run: Run, theta: np.ndarray) -> float:
        """Period of the swing, s; the period of small swings if neither angle nor rate was measured."""
        name, small = swing_channel(run), self.start_state_window_seconds(theta)
        return (
            small
            if name is None
            else min(dominant_period(run.channels[name]), MAX_MEASURED_TO_MODEL_PERIOD_RATIO * small)
        )

    def guess_start_state(self, run: Run) -> Mapping[str, float]:
        """First guesses of the start angle and rate, from a measured angle; empty without one."""
        if "swing_angle" not in run.channels:
            return {}
        return start_parameters(run, self.value("length"), [first_value_and_rate(run.channels["swing_angle"])])[0]

    def possible_start_states(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start angles and rates from which a fit is tried: points of the phase plane, near a measured angle if any."""
        pace = 2.0 * np.pi / self.start_state_window_seconds(theta)
        plane = possible_start_states(pace)
        if "swing_angle" in run.channels:
            angle, rate = first_value_and_rate(run.channels["swing_angle"])
            plane = np.array([(angle, rate + change) for change in possible_rate_errors(pace)])
        return start_parameters(run, float(theta[self.names.index("length")]), plane)

    def start_state_window_seconds(self, theta: np.ndarray) -> float:
        """Length of a run, s, that determines the angle and rate at its start: one period of small swings."""
        length, gravity = (theta[self.names.index(name)] for name in ("length", "gravity"))
        return float(2 * np.pi * np.sqrt(length / gravity))

    def split_into_pieces(self, run: Run) -> Sequence[Run]:
        """Parts of a run: between gaps of the gripper's positions; below a fixed pivot the part with a free swing."""
        return (
            cut_at_gripper_gaps(run)
            if "gripper_x" in run.channels
            else (free_swing_part(run, self.oscillation_period(run, self.theta())),)
        )

    @property
    def hangs_from_gripper(self) -> bool:
        """True: the load hangs from a gripper, for which motions can be designed."""
        return True

    @cached_property
    def formulation(self) -> str:
        """Identifier of the equations: the names of the effects."""
        return "_".join(["pendulum", *(e.name for e in catalogue_order(self.effects))])

    def dynamics(self) -> PendulumDynamics:
        """Simplified continuous equations with two states, for sequential action control."""
        return _dynamics(catalogue_order(self.effects), planar=True)

    def variational(self) -> VariationalStep:
        """Equations of the discrete variational integrator, for planning."""
        return _variational(catalogue_order(self.effects))

    def rest_angle(self) -> float:
        """Angle at which the load hangs at rest below a gripper at rest, rad: not 0 in wind or on a tilted line.

        Raises:
            InputError: it cannot hang at rest.
        """
        dynamics, theta, still = self.dynamics(), self.physics_theta(), np.zeros(7)

        def moment(angle: float) -> float:
            return float(dynamics.derivative(np.array([angle, 0.0]), still, theta)[1])

        if not moment(-MAX_REST_SWING_ANGLE_RADIANS) > 0.0 > moment(MAX_REST_SWING_ANGLE_RADIANS):
            raise InputError("the load of this model does not come to rest below the gripper: check its effects")
        return float(brentq(moment, -MAX_REST_SWING_ANGLE_RADIANS, MAX_REST_SWING_ANGLE_RADIANS, xtol=1e-12))

    def simulation_inputs(self, path: InputPath, physics: np.ndarray) -> InputPath:
        """Path of the string's upper end: the recorded path of the gripper, after the gripper's lag."""
        trails = self.system.input_lag is not None
        return super().simulation_inputs(lagged_path(path, self.gripper_lag(physics)) if trails else path, physics)

    def gripper_lag(self, physics: np.ndarray) -> float:
        """Lag of the string's upper end behind the measured gripper, s, at (p,) parameters as in `physics_names`."""
        return 0.0 if self.system.input_lag is None else float(self.system.input_lag(physics))

    def final_swing_state(self, path: GripperPath) -> tuple[float, float, float]:
        """Speed of the string's upper end, m/s, swing angle, rad, and rate, rad/s, at the end of a path."""
        physics, dynamics = self.physics_theta(), self.system
        state = self.rollout(path, self.theta(), channels=("load_force",)).states[-1]
        motion = self.simulation_inputs(path, physics).nodes[: dynamics.input_count, -1]
        return float(motion[2]), float(state[0]), float(dynamics.rate(state, motion, physics))

    def input_path(self, run: Run) -> GripperPath:
        """The recorded path of the gripper on an even grid."""
        return gripper_path(run)

    def without_null_effects(self, values: Mapping[str, float]) -> "PendulumModel":
        """The model without the effects whose parameters are all null in `values`."""
        return self.with_only_effects({p.effect for name, p in self.parameters.items() if values[name] != p.null})

    @property
    def effects_with_states(self) -> frozenset[str]:
        """Names of the effects that add states."""
        return frozenset(effect.name for effect in self.effects if _brings(effect)[0])

    @property
    def slow_effects(self) -> frozenset[str]:
        """Names of the effects that make a simulation slow, because they add states or inputs."""
        return frozenset(effect.name for effect in self.effects if any(_brings(effect)))

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which a residual may depend: predicted swing angle and rate, and the gripper's motion."""
        path = gripper_path(run)
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
        """The continuous equations of the pendulum with the effects of the model."""
        return _dynamics(catalogue_order(self.effects))


@lru_cache(maxsize=128)
def _dynamics(effects: tuple[Effect, ...], *, planar: bool = False) -> PendulumDynamics:
    return derive_dynamics(PendulumComposition(effects), planar=planar)


@lru_cache(maxsize=256)
def _brings(effect: Effect) -> tuple[bool, bool]:
    """Whether an effect adds states, and whether it adds inputs."""
    with_it = PendulumComposition([effect])
    return with_it.swings_across_line or with_it.added_state_count > 0, with_it.is_compliant or with_it.gripper_has_lag


@lru_cache(maxsize=64)
def _variational(effects: tuple[Effect, ...]) -> VariationalStep:
    return derive_variational(PendulumComposition(effects))


def pendulum_model(length: float, mass: float, effects: Iterable[Effect] = ()) -> PendulumModel:
    """Build the model of a load on a string, with effects at their null values.

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
            "gravity", "m/s^2", STANDARD_GRAVITY, GRAVITY_STD, null=STANDARD_GRAVITY, lower=1.0, upper=30.0,
            prior=Prior(STANDARD_GRAVITY, GRAVITY_STD), fitted=False, source="of free fall, where it stands",
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
    """The pendulum without effects; no entry of the model file belongs to it, so that the second result is empty."""
    del table, folder
    return pendulum_model(0.35, 0.1), {}
