"""A lab's logs: many arms, a recording every few days, friction that follows the weather, and sometimes a change.

Bodies are MuJoCo's, see `plant`; every robot has friction and a tool of its own, which its model does not know.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from armdyn.run import write_run_csv

from .drive import Lump, on_link
from .plant import Plant, perfect

FIRST_DAY = date(2026, 1, 5)
MODEL = """base = "arm"
robot = "{robot}"
joints = [{joints}]
effects = ["joint_viscous_friction", "joint_coulomb_friction", "payload:{last}"]
"""
TORQUE_NOISE, POSITION_NOISE = 0.1, 1e-4  # N m, rad
WEATHER, CORRELATION = 0.03, 0.5
"""Share by which all friction of a robot follows the temperature of the day, and how alike two days are."""
GRIP = 0.005  # kg; how much the tool's mass differs from day to day: cables, grease


@dataclass(frozen=True)
class Change:
    """What happens to one robot."""

    recording: int  # number of the first one after it
    tool: float = 0.0  # kg that its tool weighs more from then on
    dry_friction: float = 1.0  # factor of one joint's dry friction from then on
    joint: int = 2  # number of that joint


@dataclass(frozen=True)
class Lab:
    """What is recorded."""

    robots: int = 20  # how many
    recordings: int = 50  # of each, a day apart or a few
    changes: Mapping[int, Change] = field(default_factory=dict)  # by number of a robot
    robot: str = "ur5"  # the kind of arm
    seconds: float = 6.0  # that a recording lasts
    seed: int = 0  # of everything random

    def days(self, robot: int) -> Sequence[date]:
        """Of a robot's recordings."""
        gaps = np.random.default_rng([self.seed, robot, 0]).integers(1, 4, self.recordings)
        return [FIRST_DAY + timedelta(days=int(day)) for day in np.cumsum(gaps)]

    def write(self, folder: Path) -> None:
        """A folder per robot with ``model.toml`` and ``logs/log_2026-01-07.csv``."""
        joints = Plant(self.robot).joints
        for robot in range(self.robots):
            place = folder / f"robot_{robot:02d}"
            (place / "logs").mkdir(parents=True)
            names = ", ".join(f'"{joint}"' for joint in joints)
            (place / "model.toml").write_text(MODEL.format(robot=self.robot, joints=names, last=joints[-1]))
            self._record(robot, place / "logs")

    def _record(self, robot: int, folder: Path) -> None:
        plant, rng = Plant(self.robot), np.random.default_rng([self.seed, robot, 1])
        count, last = len(plant.joints), plant.joints[-1]
        viscous, coulomb = rng.uniform(1.0, 4.0, count), rng.uniform(1.0, 5.0, count)
        place = (float(rng.uniform(-0.02, 0.02)), float(rng.uniform(-0.02, 0.02)), float(rng.uniform(0.06, 0.12)))
        tool, weather, change = float(rng.uniform(0.8, 2.0)), 0.0, self.changes.get(robot)
        for number, day in enumerate(self.days(robot)):
            weather = CORRELATION * weather + np.sqrt(1.0 - CORRELATION**2) * rng.standard_normal()
            warm = 1.0 + WEATHER * weather
            dry, mass = coulomb * warm, tool + GRIP * rng.standard_normal()
            if change is not None and number >= change.recording:
                dry[change.joint] *= change.dry_friction
                mass += change.tool
            world = perfect(self.robot, "multisine", int(rng.integers(2**31)), duration=self.seconds)
            drive = replace(
                world.drive, viscous=viscous * warm, coulomb=dry, noise=np.full(count, TORQUE_NOISE),
                position_noise=POSITION_NOISE,
            )  # fmt: skip
            noise = rng.standard_normal((3, len(world.stamps), count))
            hidden = [on_link("payload", last, Lump(mass, place))]
            write_run_csv(replace(world, drive=drive).recorded(hidden, noise, "log"), folder / f"log_{day}.csv")
