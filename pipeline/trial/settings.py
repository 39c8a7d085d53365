"""What a trial is given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

from armdyn.errors import InputError
from armdyn.pendulum.model import PendulumModel
from pipeline.nodes.task import TaskSettings
from pipeline.robot.settings import PlantSettings

SHORTEST, LONGEST = 0.05, 2.0
"""m; a guess outside is a slip of the finger: Baxter's line is 0.85 m long and 1.0 m above the floor."""


@dataclass(frozen=True)
class TrialSettings:
    """One trial.

    Attributes:
        length_guess: what the robot believes at the start, pivot to the load's centre, m.
        length: the truth in the simulation, m.
        mass: of the load, as weighed, kg.
        mass_std: of the weighing, kg.
        force_noise: standard deviation of one sample of the load cell, N.
        estimate: whether to learn the length before the swing.
        estimation_time: s at most.
        enough: stop learning earlier when the standard deviation of the length is below this, m.
        least_estimation_time: but not before, s.
        hidden: effects of the simulated plant that the model does not know, None for their typical size.
        model: equations and parameters used by estimator, SAC and planner; the default one when not given.
        seed: of everything random in the simulation.
        plant: the simulated robot.
        task: the swing.
        out: directory for the recording, the model that the robot had, and the report; None keeps nothing.
        certain_enough: the largest standard deviation of the length with which the swing is tried, m.
    """

    length_guess: float = 0.328
    length: float = 0.368
    mass: float = 0.080
    mass_std: float = 0.0008
    force_noise: float = 0.005
    estimate: bool = True
    estimation_time: float = 6.0
    enough: float = 0.0
    least_estimation_time: float = 3.0
    hidden: Mapping[str, float | None] = field(default_factory=dict)
    model: PendulumModel | None = None
    seed: int = 0
    plant: PlantSettings = field(default_factory=PlantSettings)
    task: TaskSettings = field(default_factory=TaskSettings)
    out: Path | None = None
    certain_enough: float = 0.02

    def __post_init__(self) -> None:
        for name, value in (("length guess", self.length_guess), ("length", self.length)):
            if not (isfinite(value) and SHORTEST <= value <= LONGEST):
                raise InputError(
                    f"{name} {value:g} m: give a length between {SHORTEST:g} and {LONGEST:g} m, from the pivot to the "
                    "load's centre"
                )
        for name in ("mass", "mass_std", "force_noise", "estimation_time"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name.replace('_', ' ')} {getattr(self, name):g}: give a positive number")
        if self.seed < 0:
            raise InputError(f"seed {self.seed}: give a whole number from 0 on")
