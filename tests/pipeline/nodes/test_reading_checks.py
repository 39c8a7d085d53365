import pytest

from pipeline.nodes.reading_checks import MAX_SUCCESSIVE_BAD_READINGS, ForceReadingCheck, ReadingRefusal
from pipeline.robot.protocol import ForceSample

JUMP, DRIFT, TAUT, WEIGHT = 0.25, 0.04, 0.02, 0.8
FOREVER = float("inf")


@pytest.fixture
def check():
    """A check that has seen a load at rest."""
    check = ForceReadingCheck(JUMP, DRIFT, TAUT)
    assert len(take(check, [WEIGHT] * 10)) == 10
    return check


def take(check, forces, hangs_until=FOREVER):
    """What is accepted of forces that come every 10 ms."""
    good = []
    for force in forces:
        check.clock = getattr(check, "clock", 0.0) + 0.01
        good += check.check([ForceSample(check.clock, force)], check.clock, hangs_until)
    return [sample.force for sample in good]


@pytest.mark.parametrize("size", [2.0, 8.0, -3.0])
@pytest.mark.parametrize("count", [1, 2, int(MAX_SUCCESSIVE_BAD_READINGS)])
def test_spikes_are_left_out_and_counted(check, size, count):
    assert take(check, [WEIGHT + size] * count + [WEIGHT] * 3) == [WEIGHT] * 3
    assert check.refused == {ReadingRefusal.SPIKE: count}
    assert check.fault is None


def test_the_force_may_change_while_spikes_hide_it(check):
    assert take(check, [9.0] * 4 + [WEIGHT + JUMP + 0.1]) == [WEIGHT + JUMP + 0.1]


def test_a_jump_that_stays_is_a_fault_and_is_shown_to_the_detector(check):
    assert take(check, [WEIGHT + 5.0] * (int(MAX_SUCCESSIVE_BAD_READINGS) + 1)) == []
    assert "jumps farther" in check.fault
    assert [sample.force for sample in check.failed] == [WEIGHT + 5.0] * (int(MAX_SUCCESSIVE_BAD_READINGS) + 1)


def test_a_string_that_goes_slack_is_accept_once_it_is_no_spike(check):
    slack = [0.3, *[0.0] * int(MAX_SUCCESSIVE_BAD_READINGS)]
    assert take(check, slack) == slack
    assert check.fault is None


def test_a_load_that_may_touch_something_may_jump(check):
    assert take(check, [3.0, 0.0, 2.0], hangs_until=0.0) == [3.0, 0.0, 2.0]
