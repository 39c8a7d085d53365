"""A Baxter in MuJoCo, a way to lead it along its line, and how its load swings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_truth import gripper_truth, load_truth

from pipeline.robot.settings import CellSettings, PlantSettings, SimulatedJointSensorSettings
from pipeline.robot.simulated import SimulatedRobot

DEFAULT = PlantSettings()
EXACT = PlantSettings(
    relative_mass_std=0.0,
    relative_inertia_std=0.0,
    servo=replace(DEFAULT.servo, friction=(0.0,) * len(DEFAULT.servo.friction)),
    readings=SimulatedJointSensorSettings(0.0, 0.0, 0.0, (0.0,) * len(DEFAULT.readings.effort_noise)),
    cell=CellSettings(noise=0.0, resolution=0.0, bias=0.0, latency=0.0),
    box=None,
)
"""Nothing uncertain, nothing noisy: the label's mass, the URDF's inertias, no dry friction, ideal sensors."""


@pytest.fixture(scope="session")
def q_start(table):
    return table.posture(0.0).q


@pytest.fixture(scope="session")
def plant(baxter, q_start):
    """A plant with nothing uncertain and no box, but for what is named; `settings` gives another beginning."""

    def make(hidden=None, seed=0, settings=None, **changes):
        return SimulatedRobot(baxter, q_start, replace(settings or EXACT, **changes), hidden, seed)

    return make


@pytest.fixture(scope="session")
def still_pendulum(plant):
    """A plant with an arm that does not move and nothing else uncertain: a pendulum with a fixed pivot."""
    return lambda angle, hidden=None, **changes: plant(hidden, rigid_arm=True, start_angle=angle, **changes)


@pytest.fixture(scope="session")
def follow(table):
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


@pytest.fixture(scope="session")
def watch():
    """Let a plant run for some seconds and see its load from the pivot: angles in the line's plane and across it."""

    def run(plant, seconds):
        plant.advance(seconds)
        history = plant.history()
        # Baxter's line runs along y; the load is at s - l sin(angle), and -x is to the left of the line.
        string = history.load - history.pivot
        return SimpleNamespace(
            time=history.time,
            angle=np.arctan2(-string[:, 1], -string[:, 2]),
            across=np.arctan2(-string[:, 0], -string[:, 2]),
            distance=np.linalg.norm(string, axis=1),
            tension=history.tension,
        )

    return run
