"""An arm behind rosbridge as `RealRobot`: Baxter, or any that a settings file describes."""

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
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS, MAX_STATE_AGE_SECONDS, StreamGate
from pipeline.motion.transitions import BrakingMotion, StreamBlend
from pipeline.processes import Closable, HighPriorityThread
from pipeline.record import Recorder
from pipeline.robot.drivers import Connect, Driver
from pipeline.robot.link import LinkStatistics
from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.ros.baxter import Power
from pipeline.ros.bridge import Bridge
from pipeline.ros.master import MasterWatch, round_trip
from pipeline.ros.states import EvenTimes, JointStates
from pipeline.ros.telemetry import PublishingRecorder, Telemetry
from pipeline.ros.topics import RosTopics, command_message, point_message, positions_in, read_topics, settings_file

READING_LAG_SECONDS = 0.01
"""How far behind now the joints are read [s]: by then the reading of that time has usually arrived."""
ADVERTISE_SECONDS = 1.2
"""For a second after `advertise` rosbridge repeats what we send to new subscribers: nothing moves before that [s]."""
STATE_TIMEOUT = 2 * CONTROL_PERIOD_SECONDS
"""How long a command waits for a young joint state [s]: no gap yet, see `pipeline.nodes.drive.MAX_COMMAND_SILENCE`."""
JUDGEMENT_SECONDS = 0.002
"""From the end of that wait to the gate's verdict, at most [s]."""
REMEMBERED_COMMANDS = 300
"""Commands that are remembered, so that others' are recognised: 3 s, longer than any bridge may stall."""
HOLD_SECONDS = 0.3
"""How long the last posture is still commanded after braking [s]."""
SDK_TIMEOUT = 0.2
"""Baxter's own command timeout, restored at the end [s]."""
SDK_SPEED_RATIO = 0.3
"""Baxter's own speed ratio, restored at the end."""


class RosRobot(Closable):
    """An arm behind rosbridge, ``ws://HOST:9090``, with a load cell on a serial line; use it in a ``with`` block.

    Every command passes one gate (`StreamGate`); what it withholds ends the run: `fault` says why, `command` raises
    it, and nothing is sent any more except what brings the arm to rest. The arm is left enabled and holding. A load
    cell is read on the same clock [s].

    Attributes:
        joint_names: names of the commanded joints.
        statistics: what was measured.
        telemetry: told what is commanded and measured, for others to see; None without a load cell.

    Raises:
        InputError: no bridge, no joint states, or somebody else commands the arm.
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
        self.telemetry: Telemetry | None = None
        self._states = JointStates(description.joint_names)
        self._gate = StreamGate(description.joint_names, description.limits)
        self._lock = threading.RLock()
        self._ours: deque[tuple[tuple[float, ...], float]] = deque(maxlen=REMEMBERED_COMMANDS)
        self._ended: str | None = None
        self._foreign = False
        self._blend: StreamBlend | None = None
        self._sent: tuple[Vector, Vector, Vector] | None = None
        self._sent_at: float | None = None
        self._reader = EvenTimes(CONTROL_PERIOD_SECONDS)
        self._brake_from: tuple[Vector, Vector, Vector] | None = None
        self._braking, self._closing = threading.Event(), threading.Event()
        self.bridge = Bridge(uri, clock=clock)
        try:
            self._begin()
        except BaseException:
            self.bridge.close()
            raise
        if cell is not None:
            self.telemetry = Telemetry(self.bridge, self.joint_names)
        self._braker = HighPriorityThread(self._brake_when_told, "braking")
        self._braker.start()

    @property
    def time(self) -> float:
        """Our clock [s]."""
        return self._clock()

    @property
    def fault(self) -> str | None:
        """Why nothing is commanded any more; None while all is well."""
        return self._ended or self._trouble() or self._master.trouble

    def prepare(self) -> None:
        """See `RealRobot`; the arm's command timeout is set, too."""
        if self._power is not None:
            self._power.enable()
        self._configure(self._topics.command_timeout, 1.0)

    def command(self, q: Vector, v: Vector, a: Vector) -> None:
        """See `RobotInterface`: send one posture, a cycle after the last one at the earliest, if it passes the gate.

        Raises:
            TaskFailedError: it was withheld, or an earlier one was; the arm is brought to rest.
        """
        q, v, a = (np.array(x, dtype=float) for x in (q, v, a))
        if self._ended is None:
            self._states.wait_for_younger(lambda: self.time - MAX_STATE_AGE_SECONDS + JUDGEMENT_SECONDS, STATE_TIMEOUT)
            if self._sent_at is not None:  # what follows a late command on time would be faster than it was made
                self.advance(min(self._sent_at + CONTROL_PERIOD_SECONDS - self.time, CONTROL_PERIOD_SECONDS))
        with self._lock:
            if self._ended is None:
                self._braking.clear()
                state = self._states.latest
                if state is not None and q.shape == state.q.shape and self._gate.begins(self.time):
                    self._blend = StreamBlend(state.q, q)
                if self._blend is not None and q.shape == v.shape == a.shape:
                    q, v, a = self._blend.next(q, v, a)
                # Without a master the arm still follows, and so can be braked; but the run ends.
                problem = self._master.trouble or self._send(q, v, a, state)
                if problem is None:
                    return
                self._ended = problem
            self.stop()
            raise TaskFailedError(self._ended)

    def stop(self) -> None:
        """Brake within the limits, in a thread of its own, and hold; a second call does nothing."""
        with self._lock:
            if self._sent is not None and not self._braking.is_set():
                self._brake_from = self._sent
                self._braking.set()

    def advance(self, duration: float) -> None:
        """Wait."""
        if duration > 0.0:
            time.sleep(duration)

    def joint_state(self) -> JointState:
        """The joints at 100 Hz, evenly: read between the states that arrived, a little behind now.

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
        """See `RealRobot`."""
        newest = self._states.latest
        if newest is None:
            raise TaskFailedError("no joint state has arrived")
        return newest

    def load_cell(self) -> list[ForceSample]:
        """Samples that arrived since the last call.

        Raises:
            TaskFailedError: the cell's serial port is gone.
        """
        if self._cell is None:
            return []
        samples = self._cell.read()
        if not samples and not self._cell.status().connected:
            raise TaskFailedError(f"load cell: {LoadCellFault.DISCONNECTED.value}")
        if self.telemetry is not None:
            self.telemetry.load_force(samples)
        return samples

    def announce(self, phase: str) -> None:
        """See `RealRobot.announce`."""
        if self.telemetry is not None:
            self.telemetry.phase(phase)

    @property
    def recorder(self) -> Callable[..., Recorder]:
        """See `RealRobot.recorder`."""
        return Recorder if self.telemetry is None else partial(PublishingRecorder, telemetry=self.telemetry)

    def close(self) -> None:
        """Stop, wait until the arm stands, restore the robot's own settings, and end the connection."""
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
            self._configure(SDK_TIMEOUT, SDK_SPEED_RATIO)
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
        self._power = None if topics.enabling is None else Power(bridge, topics.enabling)
        self._states.first(topics.joint_states)
        self._master = MasterWatch(bridge)
        self.statistics.round_trip = round_trip(bridge)
        self.advance(advertised + ADVERTISE_SECONDS - self.time)
        if self._foreign:
            raise InputError(f"another program sends commands on {topics.command}: end it first")

    def _trouble(self) -> str | None:
        """What outside this program keeps commands from being followed; None where nothing does."""
        if self.bridge.failure is not None:
            return self.bridge.failure
        if self._foreign:
            return f"another program sends commands on {self._topics.command}: end it, then start again"
        return None if self._power is None else self._power.trouble

    def _send(self, q: Vector, v: Vector, a: Vector, state: JointState | None) -> str | None:
        """Send one posture; a sentence where it was withheld."""
        trouble = self._trouble()
        if trouble is not None:
            return trouble
        now = self.time
        refusal = self._gate.judge(q, v, a, state, now)
        if refusal is not None:
            return refusal.sentence
        assert state is not None, "the gate asks for a state"
        try:
            if self._topics.feed_forward is not None:
                self.bridge.publish(self._topics.feed_forward, point_message(q, v, a))
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
            self.telemetry.reference(q, v)
        return None

    def _take_echo(self, message: Any, now: float) -> None:
        """A command on its topic: ours, or somebody else's."""
        positions = positions_in(message, self._topics.type)
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
        for cycle in range(1, round((brake.duration + HOLD_SECONDS) / CONTROL_PERIOD_SECONDS) + 1):
            q, v, a = brake.at(cycle * CONTROL_PERIOD_SECONDS)
            due = CONTROL_PERIOD_SECONDS + (due if self._sent_at is None else max(due, self._sent_at))
            self.advance(due - self.time)
            with self._lock:
                if self._closing.is_set() or not self._braking.is_set():
                    return
                if self._send(q, v, a, self._states.latest) is not None:
                    return


def _reach(address: str, arm: str, description: urdf.Robot) -> Connect:
    topics = read_topics(settings_file(arm))
    return lambda cell, clock: RosRobot(address, description, topics, cell, clock)


DRIVER = Driver("ros", "its rosbridge, ws://HOST:9090", _reach)
