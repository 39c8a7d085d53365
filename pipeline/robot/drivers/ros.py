"""Driver for arms behind rosbridge: Baxter, or any arm that a settings file describes."""

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

import urdf
from armdyn.errors import ArmdynError, InputError, TaskFailedError
from pipeline.loadcell.cell import LoadCell
from pipeline.loadcell.faults import LoadCellFault
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS, MAX_STATE_AGE_SECONDS, CommandStreamCheck
from pipeline.motion.transitions import BrakingMotion, DecayingStartOffset
from pipeline.processes import Closable, HighPriorityThread
from pipeline.record import Recorder
from pipeline.robot.drivers import ConnectFunction, Driver
from pipeline.robot.link import LinkStatistics
from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.ros.baxter import BaxterPower
from pipeline.ros.bridge import RosBridge
from pipeline.ros.master import MasterWatch, round_trip_times
from pipeline.ros.states import EvenReadingTimes, JointStateBuffer
from pipeline.ros.telemetry import PublishingRecorder, RosTelemetryPublisher
from pipeline.ros.topics import (
    RosTopics,
    command_message,
    commanded_positions,
    read_topics,
    settings_file,
    trajectory_point_message,
)

READING_LAG_SECONDS = 0.01
"""Time before the present for which joint states are read [s]: messages of that time have usually arrived."""
WAIT_AFTER_ADVERTISE_SECONDS = 1.2
"""Time without motion after `advertise` [s], because rosbridge repeats messages to new subscribers for a second."""
RECENT_STATE_TIMEOUT_SECONDS = 2 * CONTROL_PERIOD_SECONDS
"""Longest wait of a command for a recent joint state [s], below `pipeline.nodes.drive.MAX_COMMAND_SILENCE_SECONDS`."""
MAX_COMMAND_CHECK_SECONDS = 0.002
"""Longest time from the end of the wait for a recent joint state to the end of the command's check [s]."""
MAX_REMEMBERED_COMMANDS = 300
"""Number of sent commands that are kept to recognise those of other programs: 3 s, longer than a bridge may stall."""
HOLD_AFTER_BRAKING_SECONDS = 0.3
"""Time for which the last posture is commanded after braking [s]."""
SDK_COMMAND_TIMEOUT_SECONDS = 0.2
"""Command timeout that Baxter has without this program [s], restored at the end."""
SDK_SPEED_RATIO = 0.3
"""Speed ratio that Baxter has without this program, restored at the end."""


class RosRobot(Closable):
    """An arm behind rosbridge, with an optional load cell on a serial line; use it in a ``with`` block.

    `CommandStreamCheck` checks every command. A command that it refuses ends the motion: `fault` gives the reason,
    `command` raises an error, and only commands that bring the arm to rest are sent. At the end of the block the arm is
    enabled and holds its posture.

    Args:
        uri: address of the bridge, such as ``ws://HOST:9090``.
        description: description of the arm.
        topics: topics of the arm.
        cell: the load cell, which is read on the same clock; None for none.
        clock: present time [s].

    Attributes:
        joint_names: names of the commanded joints.
        statistics: measured delays of the connection.
        telemetry: publishes commands and measurements for observers; None without a load cell.

    Raises:
        InputError: no bridge, no joint states, or another program commands the arm.
    """

    def __init__(
        self,
        uri: str,
        description: urdf.Robot,
        topics: RosTopics,
        cell: LoadCell | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._description, self._topics, self._cell, self._clock = description, topics, cell, clock
        self.joint_names, self.statistics = description.joint_names, LinkStatistics()
        self.telemetry: RosTelemetryPublisher | None = None
        self._states = JointStateBuffer(description.joint_names)
        self._gate = CommandStreamCheck(description.joint_names, description.limits)
        self._lock = threading.RLock()
        self._ours: deque[tuple[tuple[float, ...], float]] = deque(maxlen=MAX_REMEMBERED_COMMANDS)
        self._ended: str | None = None
        self._foreign = False
        self._blend: DecayingStartOffset | None = None
        self._sent: tuple[Vector, Vector, Vector] | None = None
        self._sent_at: float | None = None
        self._reader = EvenReadingTimes(CONTROL_PERIOD_SECONDS)
        self._brake_from: tuple[Vector, Vector, Vector] | None = None
        self._braking, self._closing = threading.Event(), threading.Event()
        self.bridge = RosBridge(uri, clock=clock)
        try:
            self._begin()
        except BaseException:
            self.bridge.close()
            raise
        if cell is not None:
            self.telemetry = RosTelemetryPublisher(self.bridge, self.joint_names)
        self._braker = HighPriorityThread(self._brake_when_told, "braking")
        self._braker.start()

    @property
    def time(self) -> float:
        """Present time on this program's clock [s]."""
        return self._clock()

    @property
    def fault(self) -> str | None:
        """Reason why the arm cannot be commanded any more; None while it can be."""
        return self._ended or self._trouble() or self._master.trouble

    def prepare(self) -> None:
        """Enable the arm without a motion, and set its command timeout; see `RealRobot.prepare`."""
        if self._power is not None:
            self._power.enable()
        self._configure(self._topics.command_timeout, 1.0)

    def command(self, q: Vector, v: Vector, a: Vector) -> None:
        """Check and send one reference (see `RobotInterface.command`), at least one cycle after the last one.

        Raises:
            TaskFailedError: this reference or an earlier one was refused; the arm is brought to rest.
        """
        q, v, a = (np.array(x, dtype=float) for x in (q, v, a))
        if self._ended is None:
            self._states.wait_for_recent(
                lambda: self.time - MAX_STATE_AGE_SECONDS + MAX_COMMAND_CHECK_SECONDS, RECENT_STATE_TIMEOUT_SECONDS
            )
            if self._sent_at is not None:  # what follows a late command on time would be faster than it was made
                self.advance(min(self._sent_at + CONTROL_PERIOD_SECONDS - self.time, CONTROL_PERIOD_SECONDS))
        with self._lock:
            if self._ended is None:
                self._braking.clear()
                state = self._states.latest
                if state is not None and q.shape == state.q.shape and self._gate.begins_stream(self.time):
                    self._blend = DecayingStartOffset(state.q, q)
                if self._blend is not None and q.shape == v.shape == a.shape:
                    q, v, a = self._blend.next_command(q, v, a)
                # Without a master the arm still follows, and so can be braked; but the run ends.
                problem = self._master.trouble or self._send(q, v, a, state)
                if problem is None:
                    return
                self._ended = problem
            self.stop()
            raise TaskFailedError(self._ended)

    def stop(self) -> None:
        """Brake within the limits in another thread, then hold; a second call does nothing."""
        with self._lock:
            if self._sent is not None and not self._braking.is_set():
                self._brake_from = self._sent
                self._braking.set()

    def advance(self, duration: float) -> None:
        """Wait for `duration` [s]."""
        if duration > 0.0:
            time.sleep(duration)

    def joint_state(self) -> JointState:
        """Joint state at evenly spaced times, 100 Hz, interpolated between the received states.

        Raises:
            TaskFailedError: no state has arrived.
        """
        newest, now = self.newest_state(), self.time
        if now - newest.time > MAX_STATE_AGE_SECONDS:
            return newest  # its age says that something is wrong
        state = self._states.at(self._reader.next(now - READING_LAG_SECONDS))
        assert state is not None, "there is a newest state"
        return state

    def newest_state(self) -> JointState:
        """The newest received joint state; see `RealRobot.newest_state`."""
        newest = self._states.latest
        if newest is None:
            raise TaskFailedError("no joint state has arrived")
        return newest

    def load_cell(self) -> list[ForceSample]:
        """Samples of the load cell that arrived since the last call, oldest first.

        Raises:
            TaskFailedError: the serial port of the load cell is disconnected.
        """
        if self._cell is None:
            return []
        samples = self._cell.read()
        if not samples and not self._cell.status().connected:
            raise TaskFailedError(f"load cell: {LoadCellFault.DISCONNECTED.value}")
        if self.telemetry is not None:
            self.telemetry.publish_load_force(samples)
        return samples

    def announce_phase(self, phase: str) -> None:
        """Publish the name of the trial's phase for observers."""
        if self.telemetry is not None:
            self.telemetry.publish_phase(phase)

    @property
    def recorder(self) -> Callable[..., Recorder]:
        """Class of a trial's recorder, which publishes estimates where there is telemetry; see `RealRobot.recorder`."""
        return Recorder if self.telemetry is None else partial(PublishingRecorder, telemetry=self.telemetry)

    def close(self) -> None:
        """Brake, wait until the arm is at rest, restore the robot's settings, and end the connection."""
        if self.bridge.failure is None:
            self.stop()
            end = self.time + 2.0
            while self._braking.is_set() and self.time < end:
                self.advance(CONTROL_PERIOD_SECONDS)
        with self._lock:
            self._closing.set()
            self._braking.set()
        self._master.close()
        self._braker.join(1.0)
        with suppress(ArmdynError):
            self._configure(SDK_COMMAND_TIMEOUT_SECONDS, SDK_SPEED_RATIO)
        self.bridge.close()

    def _configure(self, timeout: float, speed_ratio: float) -> None:
        for topic, value in ((self._topics.timeout, timeout), (self._topics.speed_ratio, speed_ratio)):
            if topic is not None:
                self.bridge.publish(topic, {"data": value})

    def _begin(self) -> None:
        bridge, topics = self.bridge, self._topics
        bridge.subscribe(topics.joint_states, "sensor_msgs/JointState", self._states.take)
        bridge.subscribe(topics.command, topics.type.value, self._take_echo, every=True)
        bridge.advertise(topics.command, topics.type.value)
        for topic, kind in (
            (topics.feed_forward, "trajectory_msgs/JointTrajectoryPoint"),
            (topics.timeout, "std_msgs/Float64"),
            (topics.speed_ratio, "std_msgs/Float64"),
        ):
            if topic is not None:
                bridge.advertise(topic, kind)
        advertised = self.time
        self._power = None if topics.enabling is None else BaxterPower(bridge, topics.enabling)
        self._states.first(topics.joint_states)
        self._master = MasterWatch(bridge)
        self.statistics.round_trip = round_trip_times(bridge)
        self.advance(advertised + WAIT_AFTER_ADVERTISE_SECONDS - self.time)
        if self._foreign:
            raise InputError(f"another program sends commands on {topics.command}: end it first")

    def _trouble(self) -> str | None:
        """Reason outside this program why the arm does not follow commands; None where there is none."""
        if self.bridge.failure is not None:
            return self.bridge.failure
        if self._foreign:
            return f"another program sends commands on {self._topics.command}: end it, then start again"
        return None if self._power is None else self._power.trouble

    def _send(self, q: Vector, v: Vector, a: Vector, state: JointState | None) -> str | None:
        """Send one posture, and return None; if it was not sent, return a sentence with the reason."""
        trouble = self._trouble()
        if trouble is not None:
            return trouble
        now = self.time
        refusal = self._gate.check_next(q, v, a, state, now)
        if refusal is not None:
            return refusal.sentence
        assert state is not None, "the gate asks for a state"
        try:
            if self._topics.feed_forward is not None:
                self.bridge.publish(self._topics.feed_forward, trajectory_point_message(q, v, a))
            self._ours.append((tuple(q.tolist()), now))
            self.bridge.publish(self._topics.command, command_message(self._topics, self.joint_names, q, v, a))
        except ArmdynError as error:
            return str(error)
        self.statistics.commands += 1
        self.statistics.ages.append(now - state.time)
        if self._sent_at is not None and now - self._sent_at < 10 * CONTROL_PERIOD_SECONDS:
            self.statistics.intervals.append(now - self._sent_at)
        self._sent, self._sent_at = (q, v, a), now
        if self.telemetry is not None:
            self.telemetry.publish_reference(q, v)
        return None

    def _take_echo(self, message: Any, now: float) -> None:
        """A command on its topic: ours, or somebody else's."""
        positions = commanded_positions(message, self._topics.type)
        for ours, sent_at in tuple(self._ours)[::-1]:
            if ours == positions:
                self.statistics.echoes.append(now - sent_at)
                return
        self._foreign = True

    def _brake_when_told(self) -> None:
        """The braking thread: waits for `stop`, brakes, and waits again."""
        while True:
            self._braking.wait()
            if self._closing.is_set():
                return
            with self._lock:
                start, self._brake_from = self._brake_from, None
            if start is not None:
                self._brake(start)
            with self._lock:
                if self._brake_from is None and not self._closing.is_set():  # else it was told again meanwhile
                    self._braking.clear()

    def _brake(self, start: tuple[Vector, Vector, Vector]) -> None:
        """Command the way to rest, cycle by cycle, until it is done, withheld, or a new command comes."""
        brake, due = BrakingMotion(start, self._description.limits), self.time
        for cycle in range(1, round((brake.duration + HOLD_AFTER_BRAKING_SECONDS) / CONTROL_PERIOD_SECONDS) + 1):
            q, v, a = brake.state_at(cycle * CONTROL_PERIOD_SECONDS)
            due = CONTROL_PERIOD_SECONDS + (due if self._sent_at is None else max(due, self._sent_at))
            self.advance(due - self.time)
            with self._lock:
                if self._closing.is_set() or not self._braking.is_set():
                    return
                if self._send(q, v, a, self._states.latest) is not None:
                    return


def _reach(address: str, arm: str, description: urdf.Robot) -> ConnectFunction:
    topics = read_topics(settings_file(arm))
    return lambda cell, clock: RosRobot(address, description, topics, cell, clock)


DRIVER = Driver("ros", "its rosbridge, ws://HOST:9090", _reach)
