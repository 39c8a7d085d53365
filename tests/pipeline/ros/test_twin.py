"""What the twin does with what it is sent; its time is the test's own."""

import math

import numpy as np
import pytest

import ik
import urdf
from pipeline.loadcell.protocol import decode
from pipeline.ros.topics import read_topics, settings_file
from pipeline.ros.twin import Twin

TOPICS = read_topics(settings_file("baxter"))
RAW, POSITION, TORQUE = 4, 1, 3


@pytest.fixture(scope="module")
def baxter():
    return urdf.load("baxter")


@pytest.fixture
def twin(loopback, baxter):
    with Twin(loopback.uri, baxter, TOPICS, ik.default_table(baxter).posture(0.0).q) as made:
        yield made


class Clock:
    """Lets a twin live in steps of 2 ms of its own time."""

    def __init__(self, twin):
        self.twin, self.now = twin, 100.0

    def live(self, seconds):
        for _ in range(round(seconds / 0.002)):
            self.now += 0.002
            self.twin._live(self.now, self.twin.robot.time + 0.002)

    def send(self, q, mode=RAW, names=None):
        names = list(names or self.twin._names)
        self.twin._on_command({"mode": mode, "names": names, "command": list(q)}, self.now)


@pytest.fixture
def clock(twin):
    twin._on_enable({"data": True}, 100.0)
    made = Clock(twin)
    made.live(0.15)
    assert twin._enabled
    return made


def posture(twin):
    return twin.robot.history().q[-1]


def test_it_follows_a_raw_position(twin, clock):
    goal = posture(twin) + 0.01
    for _ in range(50):
        clock.send(goal)
        clock.live(0.01)
    assert posture(twin) == pytest.approx(goal, abs=0.004)  # its joints rub
    assert twin.tally.commands == 50


def test_joints_are_matched_by_name(twin, clock):
    goal = posture(twin) + np.linspace(0.005, 0.02, 7)
    for _ in range(50):
        clock.send(goal[::-1], names=twin._names[::-1])
        clock.live(0.01)
    assert posture(twin) == pytest.approx(goal, abs=0.004)


def test_without_commands_for_the_timeout_it_holds_where_it_is(twin, clock):
    start = posture(twin)
    twin._on_timeout({"data": 0.1}, clock.now)
    for k in range(1, 31):
        clock.send(start + 0.002 * k)
        clock.live(0.01)
    clock.live(0.3)
    assert twin.tally.timeouts == 1
    here = posture(twin)
    clock.live(0.3)
    assert posture(twin) == pytest.approx(here, abs=1e-3)


def test_while_it_is_disabled_commands_have_no_effect(twin, clock):
    start = posture(twin)
    twin._on_enable({"data": False}, clock.now)
    for _ in range(20):
        clock.send(start + 0.05)
        clock.live(0.01)
    assert posture(twin) == pytest.approx(start, abs=2e-3)
    assert twin.tally.ignored == 20


def test_a_stop_needs_release_and_reset(twin, clock):
    twin.press()
    clock.live(0.01)
    twin._on_enable({"data": True}, clock.now)
    twin._on_reset({}, clock.now)
    clock.live(0.2)
    assert twin._stopped
    assert not twin._enabled
    twin.release()
    twin._on_reset({}, clock.now)
    twin._on_enable({"data": True}, clock.now)
    clock.live(0.2)
    assert twin._enabled


@pytest.mark.parametrize("bad", [[math.nan] * 7, [math.inf] * 7, [0.0] * 6, "posture", None])
def test_what_is_no_posture_is_ignored(twin, clock, bad):
    twin._on_command({"mode": RAW, "names": list(twin._names), "command": bad}, clock.now)
    assert (twin.tally.commands, twin.tally.ignored) == (0, 1)


def test_other_modes_and_other_joints_are_ignored(twin, clock):
    clock.send([0.0] * 7, mode=TORQUE)
    clock.send([0.0] * 7, names=[f"left_{k}" for k in range(7)])
    assert twin.tally.ignored == 2


def test_what_is_beyond_a_range_is_clipped_and_counted(twin, clock):
    clock.send([9.0] * 7)
    assert twin.tally.clipped == 1
    assert np.all(twin._arm.target <= twin._limits.upper)


def test_position_mode_keeps_the_speed_ratio(twin, clock):
    twin._on_speed_ratio({"data": 0.1}, clock.now)
    start = posture(twin)
    for _ in range(50):
        clock.send(start + 0.3 * np.eye(7)[0], mode=POSITION)
        clock.live(0.01)
    assert posture(twin)[0] - start[0] == pytest.approx(0.1 * 1.5 * 0.5, abs=0.015)  # it lags by 0.05 s


@pytest.mark.usefixtures("clock")
def test_baxters_states_have_17_names_in_alphabetical_order(twin, loopback):
    twin._publish_joints()
    twin._publish_power()
    loopback.wait_for(lambda: loopback.published(TOPICS.joint_states) and loopback.published("/robot/state"))
    states = loopback.published(TOPICS.joint_states)[-1]
    assert len(states["name"]) == 17
    assert states["name"] == sorted(states["name"])
    assert len(states["position"]) == len(states["velocity"]) == len(states["effort"]) == 17
    assert loopback.published("/robot/state")[-1]["enabled"] is True


def test_the_load_cell_speaks_the_serial_protocol(twin, clock):
    import os

    port = os.open(twin.port.port, os.O_RDONLY | os.O_NONBLOCK)
    clock.live(0.5)
    lines = os.read(port, 10_000).split(b"\n")
    os.close(port)
    counts = [decode(line).counts for line in lines[1:-1]]
    forces = [twin.calibration.force(count) for count in counts]
    assert np.mean(forces) == pytest.approx(9.81 * twin.robot.truth.mass, abs=0.05)
    assert len(forces) > 40
    assert len(set(counts)) > 0.95 * len(counts)  # as fine as its calibration says, or it would pass for a frozen one


def test_its_summary_tells_what_only_it_knows(twin):
    summary = twin.summary()
    assert summary["length"] == 0.368
    assert summary["load_in_box"] is False
