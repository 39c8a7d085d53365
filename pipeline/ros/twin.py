"""The twin: a simulated Baxter in real time, with Baxter's ROS topics and a load cell on a pseudo-terminal.

It is for rehearsals without the robot, and for tests.
"""

import gc
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np

import urdf
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.emulator import (
    EMULATED_NEWTONS_PER_COUNT,
    EMULATED_OFFSET_COUNTS,
    EmulatedPort,
    emulated_calibration,
)
from pipeline.processes import Closable, request_real_time_priority
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot
from pipeline.ros.bridge import BridgeError, RosBridge
from pipeline.ros.controller import BaxterController
from pipeline.ros.topics import RosTopics, time_message

TWIN_STEP_SECONDS = 0.002
"""Time between two steps of the twin, at which received messages are handled [s]."""
JOINT_STATE_PERIOD_SECONDS = 0.01
"""Time between two joint-state messages of the twin [s]."""
POWER_STATE_PERIOD_SECONDS = 0.05
"""Time between two messages on the robot's power state [s]."""
MAX_DELAY_BEHIND_REAL_TIME_SECONDS = 0.5
"""Delay behind real time from which the twin leaves out the lost time [s]."""
NO_TIMEOUT_SECONDS = 1e6
"""Command timeout of the simulated arm [s]: practically none, because `BaxterController` has the timeout."""
UNMOVED_BAXTER_JOINTS = (
    "head_nod",
    "head_pan",
    *(f"left_{j}" for j in ("e0", "e1", "s0", "s1", "w0", "w1", "w2")),
    "torso_t0",
)
"""Joints of Baxter that the twin does not simulate; its joint states contain them with zeros."""


class SimulatedBaxterOnRos(Closable):
    """A simulated Baxter on ROS; the method `run` simulates it in real time.

    Args:
        uri: address of the bridge.
        description: description of the arm.
        topics: topics of the arm.
        q_start: start posture (n,) [rad].
        settings: settings of the simulated robot; None for the default ones.
        hidden: size of each hidden effect by name, see `SimulatedRobot`.
        seed: seed of all random values.
        stamp_offset: time by which the clock of the messages is ahead of this computer's clock [s].

    Attributes:
        robot: the simulated robot.
        controller: simulated controller of Baxter, which handles and logs the received messages.
        port: emulated serial port of the load cell.
        start: time of this computer's monotonic clock at the simulation's time 0, once it runs [s].
        behind: time that was left out because this computer was too slow [s].
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
        servo = replace(settings.servo, extrapolate=False, hold_position_after_seconds=NO_TIMEOUT_SECONDS)
        # The serial line rounds to counts: a coarser cell would repeat values more often than its calibration allows.
        settings = replace(settings, servo=servo, cell=replace(settings.cell, resolution=0.0))
        self.robot = SimulatedRobot(description, q_start, settings, hidden, seed)
        self.controller = BaxterController(np.array(q_start, dtype=float), description.joint_names, description.limits)
        self._topics, self._epoch = topics, time.time() - time.monotonic() + stamp_offset
        self._inbox: list[Callable[[float], None]] = []
        self._lock = Lock()
        self.port = EmulatedPort()
        self.bridge = RosBridge(uri)
        self.start = self.behind = 0.0
        self._order = sorted((*UNMOVED_BAXTER_JOINTS, *description.joint_names))
        self._connect()

    @property
    def calibration(self) -> Calibration:
        """Calibration of the emulated load cell."""
        return emulated_calibration(max(self.robot.settings.cell.noise, EMULATED_NEWTONS_PER_COUNT), "twin")

    def summary(self) -> dict[str, Any]:
        """JSON ``armdyn.twin/1``: true values of the simulation, whether the load is in the box, counts of commands."""
        truth, log = self.robot.truth, self.controller.log
        steps = (
            np.abs(np.diff(log.positions, axis=0)) if len(log.positions) > 1 else np.zeros((1, len(truth.link_scale)))
        )
        return {
            "schema": "armdyn.twin/1",
            "seconds": self.robot.time,
            "seconds_behind": self.behind,
            "length": truth.length,
            "mass": truth.mass,
            "hidden": dict(truth.hidden),
            "load_in_box": self.robot.load_in_box(),
            "commands": len(log.received),
            "ignored": log.ignored,
            "clipped": log.clipped,
            "timeouts": log.timeouts,
            "largest_step": dict(zip(self.robot.joint_names, steps.max(axis=0).tolist(), strict=True)),
        }

    def close(self) -> None:
        """Close the load cell's port and the connection to ROS."""
        self.port.close()
        self.bridge.close()

    def run(self, until: Callable[[], bool]) -> None:
        """Simulate in real time until the function `until` returns True; it is called every few milliseconds.

        Without the bridge the arm holds its posture, as the real robot does.
        """
        request_real_time_priority()
        gc.collect()
        gc.freeze()  # loaded objects stay; the garbage collector would take 50 ms each time to search them
        self.start = time.monotonic() - self.robot.time
        next_state = next_power = self.robot.time
        while not until():
            now = time.monotonic()
            late = now - self.start - self.robot.time
            if late > MAX_DELAY_BEHIND_REAL_TIME_SECONDS:
                self.behind += late - TWIN_STEP_SECONDS
                self.start += late - TWIN_STEP_SECONDS
            self.simulate(now, now - self.start)
            if self.robot.time >= next_state - TWIN_STEP_SECONDS / 2:
                next_state = max(next_state + JOINT_STATE_PERIOD_SECONDS, self.robot.time)
                self.publish_joints()
            if self.robot.time >= next_power - TWIN_STEP_SECONDS / 2:
                next_power = max(next_power + POWER_STATE_PERIOD_SECONDS, self.robot.time)
                self.publish_power()
            time.sleep(max(0.0, self.start + self.robot.time + TWIN_STEP_SECONDS - time.monotonic()))

    def simulate(self, now: float, until: float) -> None:
        """Handle received messages, and simulate the robot.

        Args:
            now: present time on this computer's monotonic clock [s].
            until: end of the simulated interval on the simulation's clock [s].
        """
        with self._lock:
            arrived, self._inbox = self._inbox, []
        for act in arrived:
            act(now)
        span = max(0.0, until - self.robot.time)
        reference = self.controller.reference(now, span, lambda: self.robot.joint_state().q)
        if reference is not None:
            self.robot.command(*reference)
        self.robot.advance(span)
        for sample in self.robot.load_cell():
            self.port.send(
                self.port.next_line(round(EMULATED_OFFSET_COUNTS + sample.force / EMULATED_NEWTONS_PER_COUNT))
            )

    def publish_joints(self) -> None:
        """Publish one message with the states of all joints of Baxter, in alphabetical order."""
        state = self.robot.joint_state()
        rows = dict.fromkeys(UNMOVED_BAXTER_JOINTS, (0.0, 0.0, 0.0))
        rows |= {
            n: (float(q), float(v), float(t))
            for n, q, v, t in zip(self.robot.joint_names, state.q, state.v, state.tau, strict=True)
        }
        position, velocity, effort = zip(*(rows[name] for name in self._order), strict=True)
        # Stamped with the plant's time: a busy computer sends late, but the measurement belongs to that time.
        stamp = self._epoch + self.start + self.robot.time
        self._publish(self._topics.joint_states, {
            "header": {"stamp": time_message(stamp)},
            "name": self._order, "position": position, "velocity": velocity, "effort": effort,
        })  # fmt: skip

    def publish_power(self) -> None:
        """Publish whether the robot is enabled or stopped."""
        self._publish(f"{self._topics.enabling}/state", vars(self.controller.state))

    def _publish(self, topic: str, message: Mapping[str, Any]) -> None:
        with suppress(BridgeError):
            self.bridge.publish(topic, message)

    def _connect(self) -> None:
        bridge, topics, arm = self.bridge, self._topics, self.controller
        root = topics.enabling
        bridge.advertise(topics.joint_states, "sensor_msgs/JointState")
        bridge.advertise(f"{root}/state", "baxter_core_msgs/AssemblyState")
        for topic, kind, act in (
            (topics.command, topics.type.value, arm.handle_command),
            (topics.feed_forward, "trajectory_msgs/JointTrajectoryPoint", arm.handle_feed_forward),
            (topics.timeout, "std_msgs/Float64", arm.handle_timeout),
            (topics.speed_ratio, "std_msgs/Float64", arm.handle_speed_ratio),
            (f"{root}/set_super_enable", "std_msgs/Bool", arm.handle_enable),
            (f"{root}/set_super_reset", "std_msgs/Empty", arm.handle_reset),
            (f"{root}/set_super_stop", "std_msgs/Empty", arm.handle_stop),
        ):
            if topic is not None:
                bridge.subscribe(topic, kind, self._later(act), every=True)

    def _later(self, act: Callable[[Mapping[str, Any], float], None]) -> Callable[[Mapping[str, Any], float], None]:
        """Store a message from the bridge's thread; it is handled between two steps of the plant."""

        def put(message: Mapping[str, Any], _received: float) -> None:
            with self._lock:
                self._inbox.append(lambda now: act(message, now))

        return put
