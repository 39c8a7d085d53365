"""Settings of a trial: of its protocol and of its simulation, and the model with which the robot starts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.pendulum.model import PendulumModel, pendulum_model
from pipeline.box import LOAD_RADIUS
from pipeline.motion import LineTrajectory
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.nodes.task import TaskSettings
from pipeline.robot.settings import PlantSettings

MIN_STRING_LENGTH, MAX_STRING_LENGTH = 0.05, 2.0
"""Shortest and longest possible string [m]; Baxter's line is 0.85 m long and 1.0 m above the floor."""

NUISANCE_PARAMETERS: dict[str, tuple[float, float]] = {
    "linear_drag.coefficient": (0.0, 0.01),
    "sensor_bias.force": (0.0, 0.02),
    "sensor_delay.time": (0.01, 0.01),
}
"""Parameters of effects that are estimated together with the length: prior mean and standard deviation.

Without them the length would be wrong: by 0.25 mm per ms of delay, by 1 mm per 0.01 N of bias.
"""

MIN_REST_ANGLE_TO_ESTIMATE, REST_ANGLE_PRIOR_STD = 1e-3, 0.05
"""Rest angle of the load from which its start angle is estimated, and the prior's standard deviation [rad]."""
START_STD_AFTER_SWINGS = {"initial_angle": 0.05, "initial_rate": 0.2}
"""Standard deviations of start angle and rate [rad, rad/s] of a load that was brought to rest after earlier swings."""


@dataclass(frozen=True)
class ProtocolSettings:
    """Settings of the protocol of a trial on any robot.

    Attributes:
        length_guess: first guess of the string's length, from pivot to the load's centre [m].
        mass: weighed mass of the load [kg].
        mass_std: standard deviation of the weighing [kg].
        load_radius: radius of the load [m].
        force_noise: standard deviation of one sample of the load cell [N].
        estimate: whether the length is estimated before the swing.
        estimation_time: duration of the motion for the estimate that SAC chooses [s].
        max_length_std_for_swing: largest standard deviation of the length with which the swing is tried [m].
        model: model of estimator, SAC and planner; None for the default one.
        task: settings of the swing.
        motion: motion along the line for the estimate, one sample per cycle; None for a motion that SAC chooses.
        load_at_rest_at_start: whether the load is at rest at the start; after other swings it may still sway.
        investigate: largest number of experiments that identify the model's missing effects first; 0 for none.
        clock: time of the robot at which the model's own time is 0 [s], for effects that change with time; None for the
            start of the motion.
    """

    length_guess: float = 0.328
    mass: float = 0.080
    mass_std: float = 0.0008
    load_radius: float = LOAD_RADIUS
    force_noise: float = 0.005
    estimate: bool = True
    estimation_time: float = 6.0
    max_length_std_for_swing: float = 0.02
    model: PendulumModel | None = None
    task: TaskSettings = field(default_factory=TaskSettings)
    motion: LineTrajectory | None = None
    load_at_rest_at_start: bool = True
    investigate: int = 0
    clock: float | None = None

    def __post_init__(self) -> None:
        _check_length("length guess", self.length_guess)
        for name in ("mass", "mass_std", "load_radius", "force_noise", "estimation_time"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name.replace('_', ' ')} {getattr(self, name):g}: give a positive number")
        if self.motion is not None and not np.allclose(np.diff(self.motion.time), CONTROL_PERIOD_SECONDS, atol=1e-6):
            raise InputError(
                f"the motion has no sample every {CONTROL_PERIOD_SECONDS:g} s: "
                "write it at the rate of the robot's cycle"
            )

    def starting_model(self) -> PendulumModel:
        """The given model, or a pendulum, with the nuisance effects, the weighed mass and the guessed length.

        A fitted parameter of the given model's effects becomes a prior; without a standard deviation it stays fixed.
        """
        given = self.model or pendulum_model(self.length_guess, self.mass)
        model = given
        for effect in given.effects:
            for p in effect.parameters():
                fitted = given.parameters[p.name]
                model = model.with_prior(p.name, fitted.value, fitted.std) if fitted.std else model.with_fixed(p.name)
        for parameter, (mean, std) in NUISANCE_PARAMETERS.items():
            name = parameter.partition(".")[0]
            if all(effect.name != name for effect in given.named_effects):
                model = model.with_effect(CATALOGUE[name]).with_prior(parameter, mean, std)
        model = model.with_prior("mass", self.mass, self.mass_std)
        model = model.with_values({"length": self.length_guess})
        rest = model.rest_angle()
        # The load hangs at rest at first; where an effect deflects it, its angle is as uncertain as the effect.
        model = model.with_values({"initial_angle": rest, "initial_rate": 0.0})
        if not self.load_at_rest_at_start:
            for name, at in (("initial_angle", rest), ("initial_rate", 0.0)):
                model = model.with_prior(name, at, START_STD_AFTER_SWINGS[name])
            return model
        model = model.with_fixed("initial_rate")
        if abs(rest) > MIN_REST_ANGLE_TO_ESTIMATE:
            return model.with_prior("initial_angle", rest, REST_ANGLE_PRIOR_STD)
        return model.with_fixed("initial_angle")


@dataclass(frozen=True)
class TrialSettings(ProtocolSettings):
    """Settings of a trial on the simulated robot.

    Attributes:
        true_length: true length of the string in the simulation [m].
        hidden: size of each effect of the simulated robot that the model lacks, by name; None for its typical size.
        seed: seed of all random values of the simulation.
        plant: settings of the simulated robot; length, mass and radius of the load are taken from these settings.
        out: directory for recording and model; None to write no files.
    """

    true_length: float = 0.368
    hidden: Mapping[str, float | None] = field(default_factory=dict)
    seed: int = 0
    plant: PlantSettings = field(default_factory=PlantSettings)
    out: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_length("length", self.true_length)
        if self.seed < 0:
            raise InputError(f"seed {self.seed}: give a whole number from 0 on")


def _check_length(name: str, value: float) -> None:
    if not (isfinite(value) and MIN_STRING_LENGTH <= value <= MAX_STRING_LENGTH):
        raise InputError(
            f"{name} {value:g} m: give a length between {MIN_STRING_LENGTH:g} and {MAX_STRING_LENGTH:g} m, "
            "from the pivot to the load's centre"
        )
