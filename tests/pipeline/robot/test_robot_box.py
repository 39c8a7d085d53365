from dataclasses import replace

import numpy as np
import pytest
from simulated_truth import load_truth

from pipeline.box import Box

AROUND_THE_LOAD = Box(near_wall=-0.15, width=0.30, rim=0.30, height=0.15)


def test_load_in_the_box_counts_after_a_fifth_of_a_second(plant):
    robot = plant(box=AROUND_THE_LOAD)
    robot.advance(0.19)
    assert not robot.load_in_box()
    robot.advance(0.02)
    assert robot.load_in_box()


@pytest.mark.parametrize(
    ("box", "angle"),
    [
        (Box(), 0.0),  # it hangs beside the box
        (replace(AROUND_THE_LOAD, rim=0.39), 0.0),  # above the rim
        (replace(AROUND_THE_LOAD, rim=0.366, near_wall=-0.5, width=1.0), 0.6),  # below the rim for 0.1 s at a time
    ],
)
def test_load_that_is_not_at_rest_in_the_box_does_not_count(plant, box, angle):
    robot = plant(box=box, rigid_arm=True, start_angle=angle)
    for _ in range(300):
        robot.advance(0.01)
        assert not robot.load_in_box()


@pytest.mark.parametrize("angle", [0.6, 1.2])
def test_wall_stops_the_load(still_pendulum, baxter, angle):
    # Released on the left, the load meets the wall that stands to the right of its lowest point.
    robot = still_pendulum(angle, box=Box(near_wall=0.05, width=0.3, rim=0.30, height=0.095))
    robot.advance(3.0)
    position = robot.history().load[:, 1] - baxter.line.origin[1]
    assert position.max() < 0.05 - robot.settings.load_radius + 0.004
    assert position.min() < -0.15


def test_floor_carries_a_load_whose_string_is_slack(still_pendulum, baxter):
    # Let go on its string from the right with the rim below its path, the load ends in the box and its string is slack.
    robot = still_pendulum(0.0, box=Box(near_wall=-0.2, width=0.4, rim=0.25, height=0.10))
    at_rest = baxter.line.origin[2] - 0.25 - 0.10 + robot.settings.load_radius
    robot._data.qpos[9] = at_rest + 0.03
    robot.advance(1.5)
    load = load_truth(robot)
    assert robot.load_in_box()
    assert load.tension == 0.0
    assert load.position[2] == pytest.approx(at_rest, abs=1e-3)
    assert np.linalg.norm(load.velocity) < 0.05
