"""A Baxter in MuJoCo, a way to lead it along its line, and how its load swings."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from simulated_truth import gripper_truth, load_truth

import ik
import urdf
from pipeline.robot.settings import CellSettings, PlantSettings, ReadingSettings
from pipeline.robot.simulated import SimulatedRobot

Vector = npt.NDArray[np.float64]


def exact_settings() -> PlantSettings:
    """Nothing uncertain, nothing noisy: the label's mass, the URDF's inertias, no dry friction, ideal sensors."""
    default = PlantSettings()
    return PlantSettings(
        mass_spread=0.0,
        inertia_spread=0.0,
        servo=replace(default.servo, friction=(0.0,) * len(default.servo.friction)),
        readings=ReadingSettings(0.0, 0.0, 0.0, (0.0,) * len(default.readings.effort_noise)),
        cell=CellSettings(noise=0.0, resolution=0.0, bias=0.0, latency=0.0),
        box=None,
    )


@pytest.fixture(scope="session")
def q_start(table: ik.LineTable) -> Vector:
    return table.posture(0.0).q


@pytest.fixture(scope="session")
def plant(baxter: urdf.Robot, q_start: Vector) -> Callable[..., SimulatedRobot]:
    """A plant with nothing uncertain and no box, but for what is named; `settings` gives another beginning."""

    def make(hidden=None, seed=0, settings=None, **changes) -> SimulatedRobot:
        settings = settings or exact_settings()
        return SimulatedRobot(baxter, q_start, replace(settings, **changes), hidden, seed)

    return make


@pytest.fixture(scope="session")
def still_pendulum(plant: Callable[..., SimulatedRobot]) -> Callable[..., SimulatedRobot]:
    """A plant with an arm that does not move and nothing else uncertain: a pendulum with a fixed pivot."""
    return lambda angle, hidden=None, **changes: plant(hidden, rigid_arm=True, start_angle=angle, **changes)


@pytest.fixture(scope="session")
def follow(table: ik.LineTable):
    """Command s(t), v(t), a(t) at 100 Hz; gives (time, s commanded, gripper truth, load truth) every 10 ms."""

    def lead(plant, path, seconds):
        rows = []
        for _ in range(round(seconds / 0.01)):
            s, v, a = path(plant.time)
            motion = table.joint_motion(s, v, a)
            plant.command(motion.q, motion.v, motion.a)
            rows.append((plant.time, s, gripper_truth(plant), load_truth(plant)))
            plant.advance(0.01)
        return rows

    return lead


@dataclass(frozen=True)
class Swing:
    """History of a plant as seen from the pivot: angle in the plane of the line, angle across, distance."""

    time: Vector
    angle: Vector
    across: Vector
    distance: Vector
    tension: Vector


@pytest.fixture(scope="session")
def watch() -> Callable[[SimulatedRobot, float], Swing]:
    """Let a plant run for some seconds and see how its load swings."""

    def run(plant: SimulatedRobot, seconds: float) -> Swing:
        plant.advance(seconds)
        history = plant.history()
        string = history.load - history.pivot
        # Baxter's line runs along y; the load is at s - l sin(angle), and -x is to the left of the line.
        return Swing(
            history.time,
            np.arctan2(-string[:, 1], -string[:, 2]),
            np.arctan2(-string[:, 0], -string[:, 2]),
            np.linalg.norm(string, axis=1),
            history.tension,
        )

    return run
