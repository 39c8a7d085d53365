import pytest

from pipeline.nodes.door import PATIENCE, ForceDoor, Refused
from pipeline.robot.protocol import ForceSample

JUMP, DRIFT, TAUT, WEIGHT = 0.25, 0.04, 0.02, 0.8
FOREVER = float("inf")


@pytest.fixture
def door():
    """A door that has seen a load at rest."""
    door = ForceDoor(JUMP, DRIFT, TAUT)
    assert len(take(door, [WEIGHT] * 10)) == 10
    return door


def take(door, forces, hangs_until=FOREVER):
    """What the door lets in of forces that come every 10 ms."""
    good = []
    for force in forces:
        door.clock = getattr(door, "clock", 0.0) + 0.01
        good += door.judge([ForceSample(door.clock, force)], door.clock, hangs_until)
    return [sample.force for sample in good]


@pytest.mark.parametrize("size", [2.0, 8.0, -3.0])
@pytest.mark.parametrize("count", [1, 2, int(PATIENCE)])
def test_spikes_are_left_out_and_counted(door, size, count):
    assert take(door, [WEIGHT + size] * count + [WEIGHT] * 3) == [WEIGHT] * 3
    assert door.refused == {Refused.SPIKE: count}
    assert door.fault is None


def test_the_force_may_change_while_spikes_hide_it(door):
    assert take(door, [9.0] * 4 + [WEIGHT + JUMP + 0.1]) == [WEIGHT + JUMP + 0.1]


def test_a_jump_that_stays_is_a_fault_and_is_shown_to_the_detector(door):
    assert take(door, [WEIGHT + 5.0] * (int(PATIENCE) + 1)) == []
    assert "jumps farther" in door.fault
    assert [sample.force for sample in door.failed] == [WEIGHT + 5.0] * (int(PATIENCE) + 1)


def test_a_string_that_goes_slack_is_let_in_once_it_is_no_spike(door):
    slack = [0.3, *[0.0] * int(PATIENCE)]
    assert take(door, slack) == slack
    assert door.fault is None


def test_a_load_that_may_touch_something_may_jump(door):
    assert take(door, [3.0, 0.0, 2.0], hangs_until=0.0) == [3.0, 0.0, 2.0]
