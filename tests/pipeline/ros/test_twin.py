"""What the twin does with what it is sent; its time is the test's own."""

import math
import os

import numpy as np
import pytest
from ros_wire.messages import TOPICS

from pipeline.loadcell.protocol import decode_load_cell_line
from pipeline.ros.topics import JOINT_COMMAND_MODES
from pipeline.ros.twin import SimulatedBaxterOnRos

RAW, POSITION, TORQUE = JOINT_COMMAND_MODES["raw_position"], JOINT_COMMAND_MODES["position"], 3


class SteppedTwin(SimulatedBaxterOnRos):
    """A twin that lives in steps of 2 ms of its own time, and is sent messages without a bridge."""

    now = 100.0

    def pass_time(self, seconds):
        for _ in range(round(seconds / 0.002)):
            self.now += 0.002
            self.simulate(self.now, self.robot.time + 0.002)

    def send(self, q, mode=RAW, names=None, cycles=1):
        """Ask for a posture once or in several cycles of 10 ms."""
        command = {"mode": mode, "names": list(names or self.robot.joint_names), "command": q}
        for _ in range(cycles):
            self.controller.handle_command(command, self.now)
            self.pass_time(0.01)

    def enable(self, on=True):
        self.controller.handle_enable({"data": on}, self.now)
        self.pass_time(0.15)

    @property
    def posture(self):
        return self.robot.history().q[-1]


@pytest.fixture
def twin(loopback, baxter, table):
    with SteppedTwin(loopback.uri, baxter, TOPICS, table.posture(0.0).q) as made:
        made.enable()
        assert made.controller.state.enabled
        yield made


def test_it_follows_a_raw_position_and_matches_joints_by_name(twin):
    goal = twin.posture + np.linspace(0.005, 0.02, 7)
    twin.send(goal[::-1].tolist(), names=twin.robot.joint_names[::-1], cycles=50)
    assert twin.posture == pytest.approx(goal, abs=0.004)  # its joints rub
    assert len(twin.controller.log.received) == 50


def test_without_commands_for_the_timeout_it_holds_where_it_is(twin):
    start = twin.posture
    twin.controller.handle_timeout({"data": 0.1}, twin.now)
    for k in range(1, 31):
        twin.send((start + 0.002 * k).tolist())
    twin.pass_time(0.3)
    assert twin.controller.log.timeouts == 1
    here = twin.posture
    twin.pass_time(0.3)
    assert twin.posture == pytest.approx(here, abs=1e-3)


def test_while_it_is_disabled_commands_have_no_effect(twin):
    start = twin.posture
    twin.enable(False)
    twin.send((start + 0.05).tolist(), cycles=20)
    assert twin.posture == pytest.approx(start, abs=2e-3)
    assert twin.controller.log.ignored == 20


def test_a_stop_needs_release_and_reset(twin):
    arm = twin.controller
    arm.press()
    arm.handle_reset({}, twin.now)
    twin.enable()
    assert (arm.state.stopped, arm.state.enabled) == (True, False)
    arm.release()
    arm.handle_reset({}, twin.now)
    twin.enable()
    assert arm.state.enabled


@pytest.mark.parametrize(
    "bad", [{"q": q} for q in ([math.nan] * 7, [math.inf] * 7, [0.0] * 6, "posture", None)]
    + [{"q": [0.0] * 7, "mode": TORQUE}, {"q": [0.0] * 7, "names": [f"left_{k}" for k in range(7)]}]
)  # fmt: skip
def test_what_is_no_posture_another_mode_and_other_joints_are_ignored(twin, bad):
    twin.send(**bad)
    assert (len(twin.controller.log.received), twin.controller.log.ignored) == (0, 1)


def test_position_mode_keeps_the_speed_ratio(twin):
    twin.controller.handle_speed_ratio({"data": 0.1}, twin.now)
    start = twin.posture
    twin.send((start + 0.3 * np.eye(7)[0]).tolist(), mode=POSITION, cycles=50)
    assert twin.posture[0] - start[0] == pytest.approx(0.1 * 1.5 * 0.5, abs=0.015)  # it lags by 0.05 s


def test_baxters_states_have_17_names_in_alphabetical_order(twin, loopback):
    twin.publish_joints()
    twin.publish_power()
    loopback.wait_for(lambda: loopback.published(TOPICS.joint_states) and loopback.published("/robot/state"))
    states = loopback.published(TOPICS.joint_states)[-1]
    assert states["name"] == sorted(states["name"])
    assert {len(states[key]) for key in ("name", "position", "velocity", "effort")} == {17}
    assert loopback.published("/robot/state")[-1]["enabled"] is True


def test_the_load_cell_speaks_the_serial_protocol(twin):
    port = os.open(twin.port.port, os.O_RDONLY | os.O_NONBLOCK)
    twin.pass_time(0.5)
    lines = os.read(port, 10_000).split(b"\n")
    os.close(port)
    counts = [decode_load_cell_line(line).counts for line in lines[1:-1]]
    forces = [twin.calibration.force(count) for count in counts]
    assert np.mean(forces) == pytest.approx(9.81 * twin.robot.truth.mass, abs=0.05)
    assert len(forces) > 40
    assert len(set(counts)) > 0.95 * len(counts)  # as fine as its calibration says, or it would pass for a frozen one


def test_its_summary_tells_what_only_it_knows_also_what_was_clipped(twin, baxter):
    twin.send((twin.posture + 0.01).tolist())
    command = {"mode": RAW, "names": list(twin.robot.joint_names), "command": [9.0] * 7}
    twin.controller.handle_command(command, twin.now)
    summary = twin.summary()
    assert (summary["length"], summary["load_in_box"], summary["commands"]) == (0.368, False, 2)
    assert set(summary["largest_step"]) == set(twin.robot.joint_names)
    assert twin.controller.log.clipped == 1
    assert np.all(twin.controller.target <= baxter.limits.upper)
