"""The twin: the simulated Baxter in real time behind Baxter's own topics, its load cell on a pseudo-terminal.

A lab rehearses with it, and the tests use it. It does what the real robot does with what it is sent: commands while it
is disabled have no effect, no command for the timeout makes it hold where it is, and a command that is not a number is
ignored. Modes other than the two position modes are ignored as well.
"""

import gc
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from math import isfinite
from threading import Lock
from typing import Any

import numpy as np

import urdf
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.emulator import EmulatedPort
from pipeline.processes import Closing, ask_for_real_time
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot
from pipeline.ros.baxter import CommandedArm, Tally
from pipeline.ros.bridge import Bridge, BridgeError
from pipeline.ros.topics import RosTopics

STEP = 0.002
"""Time between two looks at what has arrived [s]."""
STATE_EVERY = 0.01
"""Time between two joint states [s]."""
POWER_EVERY = 0.05
"""Time between two messages on whether the robot is enabled [s]; the bridge has to convert each."""
ENABLE_TAKES = 0.1
"""From the request to being enabled [s]."""
OFFSET, SCALE = 84213.0, 5.6e-6
"""Counts of the empty cell, and newtons per count: a 1 kg cell of 1 mV/V behind an HX711."""
FAR_BEHIND = 0.5
"""A computer that is this late [s] cannot run the twin in real time; the time is left out, and said."""
NEVER = 1e6
"""The plant itself never times out [s]: the twin does, as the robot would."""
OTHERS = (
    "head_nod",
    "head_pan",
    "left_e0",
    "left_e1",
    "left_s0",
    "left_s1",
    "left_w0",
    "left_w1",
    "left_w2",
    "torso_t0",
)
"""Joints of Baxter that do not move here, among its joint states."""
POSITION, RAW_POSITION = 1, 4


class Twin(Closing):
    """A simulated Baxter on ROS; `run` keeps it alive.

    Args:
        uri: of the bridge.
        description: the arm.
        topics: what it is called; they must be Baxter's.
        q_start: where it begins (n,) [rad].
        settings: of the plant.
        hidden: effects that nobody's model knows.
        seed: of everything random.
        stamp_offset: by how much the robot's clock is ahead of this computer's [s].

    Attributes:
        robot: the plant.
        tally: what it was sent.
        port: the microcontroller's end of the load cell's line.
        start: this computer's monotonic time at the plant's time 0, once it runs [s].
    """

    def __init__(
        self,
        uri: str,
        description: urdf.Robot,
        topics: RosTopics,
        q_start: Vector,
        settings: PlantSettings | None = None,
        hidden: Mapping[str, float | None] | None = None,
        seed: int = 0,
        stamp_offset: float = 0.0,
    ) -> None:
        settings = settings or PlantSettings()
        servo = replace(settings.servo, extrapolate=False, hold_after=NEVER)
        # The line rounds to counts: a coarser cell would repeat itself more often than its calibration allows.
        self.settings = replace(settings, servo=servo, cell=replace(settings.cell, resolution=0.0))
        self._names, self._limits = description.joint_names, description.limits
        self.robot = SimulatedRobot(description, q_start, self.settings, hidden, seed)
        self.tally = Tally(largest_step=np.zeros(len(self._names)))
        self._topics, self._stamp_offset = topics, stamp_offset
        self._arm = CommandedArm(np.array(q_start, dtype=float), self._limits)
        self._inbox: list[Callable[[float], None]] = []
        self._lock = Lock()
        self.port = EmulatedPort()
        self.bridge = Bridge(uri)
        self._enabled, self._stopped, self._button, self._source = False, False, 0, 0
        self._enabling: float | None = None
        self._epoch = self.start = 0.0
        self._order = sorted((*OTHERS, *self._names))
        self._connect()

    @property
    def calibration(self) -> Calibration:
        """Of the emulated load cell."""
        noise = max(self.settings.cell.noise, SCALE)
        return Calibration(OFFSET, 0.0, SCALE, 0.0, noise, datetime.now().astimezone().replace(microsecond=0), "twin")

    def summary(self) -> dict[str, Any]:
        """What the twin knows and nobody else: the truth, where the load is, and what it was sent."""
        truth, tally = self.robot.truth, self.tally
        return {
            "schema": "armdyn.twin/1",
            "seconds": self.robot.time,
            "seconds_behind": tally.behind,
            "length": truth.length,
            "mass": truth.mass,
            "hidden": dict(truth.hidden),
            "load_in_box": self.robot.load_in_box(),
            "commands": tally.commands,
            "ignored": tally.ignored,
            "clipped": tally.clipped,
            "timeouts": tally.timeouts,
            "largest_step": dict(zip(self._names, tally.largest_step.tolist(), strict=True)),
        }

    def close(self) -> None:
        """Unplug the load cell and end the connection."""
        self.port.close()
        self.bridge.close()

    def run(self, until: Callable[[], bool]) -> None:
        """Live in real time until a condition holds; without the bridge the arm holds, as the robot would.

        Args:
            until: the condition; looked at every few ms.
        """
        ask_for_real_time()
        gc.collect()
        gc.freeze()  # what was loaded stays; looking through it again and again would take 50 ms each time
        start = self.start = time.monotonic() - self.robot.time
        self._epoch = time.time() - self.robot.time + self._stamp_offset
        next_state = next_power = self.robot.time
        while not until():
            now = time.monotonic()
            late = now - start - self.robot.time
            if late > FAR_BEHIND:
                self.tally.behind += late - STEP
                start = self.start = start + late - STEP
                self._epoch += late - STEP
            self._live(now, now - start)
            if self.robot.time >= next_state - STEP / 2:
                next_state = max(next_state + STATE_EVERY, self.robot.time)
                self._publish_joints()
            if self.robot.time >= next_power - STEP / 2:
                next_power = max(next_power + POWER_EVERY, self.robot.time)
                self._publish_power()
            time.sleep(max(0.0, start + self.robot.time + STEP - time.monotonic()))

    def _live(self, now: float, until: float) -> None:
        """Take in what arrived, and let the plant come to a time of its own clock [s]."""
        with self._lock:
            arrived, self._inbox = self._inbox, []
        for act in arrived:
            act(now)
        if self._enabling is not None and now >= self._enabling:
            self._enabling, self._enabled = None, True
        timed_out = self._enabled and self._arm.timed_out(now)
        self.tally.timeouts += timed_out
        if timed_out or not self._enabled:
            self._arm.hold(self.robot.joint_state().q)
        span = max(0.0, until - self.robot.time)
        reference = self._arm.advance(span)
        if reference is not None:
            self.robot.command(*reference)
        self.robot.advance(span)
        for sample in self.robot.load_cell():
            self.port.send(self.port.line(round(OFFSET + sample.force / SCALE)))

    def _publish_joints(self) -> None:
        state = self.robot.joint_state()
        rows = dict.fromkeys(OTHERS, (0.0, 0.0, 0.0))
        rows |= {
            n: (float(q), float(v), float(t))
            for n, q, v, t in zip(self._names, state.q, state.v, state.tau, strict=True)
        }
        columns = [[rows[name][i] for name in self._order] for i in range(3)]
        # Of the plant's time: what a busy computer sends late is still what was measured then.
        stamp = self._epoch + self.robot.time
        self._say(self._topics.joint_states, {
            "header": {"stamp": {"secs": int(stamp), "nsecs": round(1e9 * (stamp % 1.0)) % 1_000_000_000}},
            "name": self._order, "position": columns[0], "velocity": columns[1], "effort": columns[2],
        })  # fmt: skip

    def _publish_power(self) -> None:
        self._say(f"{self._topics.enabling}/state", {
            "enabled": self._enabled, "ready": self._enabled, "stopped": self._stopped, "error": False,
            "estop_button": self._button, "estop_source": self._source,
        })  # fmt: skip

    def _say(self, topic: str, message: Mapping[str, Any]) -> None:
        with suppress(BridgeError):
            self.bridge.publish(topic, message)

    def _connect(self) -> None:
        bridge, topics = self.bridge, self._topics
        root = topics.enabling
        bridge.advertise(topics.joint_states, "sensor_msgs/JointState")
        bridge.advertise(f"{root}/state", "baxter_core_msgs/AssemblyState")
        for topic, kind, act in (
            (topics.command, topics.kind.value, self._on_command),
            (topics.feed_forward, "trajectory_msgs/JointTrajectoryPoint", self._on_feed_forward),
            (topics.timeout, "std_msgs/Float64", self._on_timeout),
            (topics.speed_ratio, "std_msgs/Float64", self._on_speed_ratio),
            (f"{root}/set_super_enable", "std_msgs/Bool", self._on_enable),
            (f"{root}/set_super_reset", "std_msgs/Empty", self._on_reset),
            (f"{root}/set_super_stop", "std_msgs/Empty", lambda _m, _now: self.press(button=2, source=2)),
        ):
            if topic is not None:
                bridge.subscribe(topic, kind, self._later(act), every=True)

    def _later(self, act: Callable[[Mapping[str, Any], float], None]) -> Callable[[Mapping[str, Any], float], None]:
        """Messages arrive in the bridge's thread; they are acted on between two steps of the plant."""

        def put(message: Mapping[str, Any], _received: float) -> None:
            with self._lock:
                self._inbox.append(lambda now: act(message, now))

        return put

    def between_steps(self, act: Callable[[], None]) -> None:
        """Have something done between two steps of the plant, from any thread."""
        self._later(lambda _message, _now: act())({}, 0.0)

    def press(self, button: int = 1, source: int = 1) -> None:
        """Press the red button (or stop by software: 2, 2): the arm is disabled until it is released and reset."""
        self._enabling, self._enabled, self._stopped = None, False, True
        self._button, self._source = button, source

    def release(self) -> None:
        """Release the red button; the robot stays stopped until it is reset."""
        if self._button == 1:
            self._button = 3

    def _on_enable(self, message: Mapping[str, Any], now: float) -> None:
        if message.get("data") is not True:
            self._enabled, self._enabling = False, None
        elif not (self._stopped or self._enabled) and self._enabling is None:
            self._enabling = now + ENABLE_TAKES

    def _on_reset(self, _message: Mapping[str, Any], _now: float) -> None:
        if self._button != 1:
            self._enabled = self._stopped = False
            self._button = self._source = 0

    def _on_timeout(self, message: Mapping[str, Any], _now: float) -> None:
        value = message.get("data")
        if isinstance(value, float | int) and isfinite(value) and value > 0:
            self._arm.timeout = float(value)

    def _on_speed_ratio(self, message: Mapping[str, Any], _now: float) -> None:
        value = message.get("data")
        if isinstance(value, float | int) and isfinite(value):
            self._arm.ratio = min(max(float(value), 0.0), 1.0)

    def _on_feed_forward(self, message: Mapping[str, Any], _now: float) -> None:
        v, a = (self._vector(message.get(name)) for name in ("velocities", "accelerations"))
        if v is not None and a is not None:
            self._arm.feed(v, a)

    def _on_command(self, message: Mapping[str, Any], now: float) -> None:
        q = self._vector(message.get("command"))
        names = message.get("names")
        known = isinstance(names, list) and sorted(map(str, names)) == sorted(self._names)
        if q is None or not known or message.get("mode") not in (POSITION, RAW_POSITION) or not self._enabled:
            self.tally.ignored += 1
            return
        assert isinstance(names, list), "names were looked at above"
        q = q[[names.index(name) for name in self._names]]
        tally, before = self.tally, self._arm.target
        if np.any((q < self._limits.lower) | (q > self._limits.upper)):
            tally.clipped += 1
        tally.commands += 1
        tally.after_timeout += self._arm.waiting and bool(np.max(np.abs(q - before)) > 1e-9) and tally.timeouts > 0
        tally.largest_step = np.maximum(tally.largest_step, np.abs(q - before))
        tally.received.append(now)
        tally.positions.append(q)
        self._arm.command(np.clip(q, self._limits.lower, self._limits.upper), now, message["mode"] == RAW_POSITION)

    def _vector(self, given: object) -> Vector | None:
        """One finite number per joint; None where it is anything else."""
        try:
            vector = np.array(given, dtype=float)
        except (TypeError, ValueError):
            return None
        return vector if vector.shape == (len(self._names),) and np.isfinite(vector).all() else None
