from dataclasses import replace

import numpy as np
import pytest

from pipeline.box import Box
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot

AROUND_THE_LOAD = Box(near_wall=-0.15, width=0.30, rim=0.30, height=0.15)


def test_load_in_the_box_counts_after_a_fifth_of_a_second(baxter, q_start):
    plant = SimulatedRobot(baxter, q_start, replace(PlantSettings.exact(), box=AROUND_THE_LOAD))
    plant.advance(0.19)
    assert not plant.load_in_box()
    plant.advance(0.02)
    assert plant.load_in_box()


def test_load_hanging_beside_the_box_is_not_in_it(baxter, q_start):
    plant = SimulatedRobot(baxter, q_start)
    plant.advance(0.5)
    assert not plant.load_in_box()


def test_load_above_the_rim_is_not_in_the_box(baxter, q_start):
    box = replace(AROUND_THE_LOAD, rim=0.39)
    plant = SimulatedRobot(baxter, q_start, replace(PlantSettings.exact(), box=box))
    plant.advance(0.5)
    assert not plant.load_in_box()


def test_load_passing_through_the_opening_is_not_in_the_box(still_pendulum):
    # The load swings 0.2 m to either side and is below the rim for some 0.1 s at a time only.
    plant = still_pendulum(0.6)
    inside = SimulatedRobot(
        plant._robot,
        plant._data.qpos[plant._plant.dofs],
        replace(plant.settings, box=replace(AROUND_THE_LOAD, rim=0.366, near_wall=-0.5, width=1.0)),
    )
    seen = []
    for _ in range(300):
        inside.advance(0.01)
        seen.append(inside.load_in_box())
    assert not any(seen)


@pytest.mark.parametrize("angle", [0.6, 1.2])
def test_wall_stops_the_load(baxter, q_start, angle):
    # Released on the left, the load meets the wall that stands to the right of its lowest point.
    box = Box(near_wall=0.05, width=0.3, rim=0.30, height=0.095)
    settings = replace(PlantSettings.exact(), rigid_arm=True, start_angle=angle, box=box)
    plant = SimulatedRobot(baxter, q_start, settings)
    plant.advance(3.0)
    position = plant.history().load[:, 1] - baxter.line.origin[1]
    assert position.max() < 0.05 - settings.load_radius + 0.004
    assert position.min() < -0.15


def test_floor_carries_a_load_whose_string_is_slack(baxter, q_start):
    # Let go on its string from the right with the rim below its path, the load ends in the box and its string is slack.
    box = Box(near_wall=-0.2, width=0.4, rim=0.25, height=0.10)
    settings = replace(PlantSettings.exact(), rigid_arm=True, box=box)
    plant = SimulatedRobot(baxter, q_start, settings)
    floor = baxter.line.origin[2] - 0.25 - 0.10
    plant._data.qpos[9] = floor + settings.load_radius + 0.03
    plant.advance(1.5)
    load = plant.load_truth()
    assert plant.load_in_box()
    assert load.tension == 0.0
    assert load.position[2] == pytest.approx(floor + settings.load_radius, abs=1e-3)
    assert np.linalg.norm(load.velocity) < 0.05
