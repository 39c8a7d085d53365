"""Record joint states, wrenches and load cell of a ROS robot; no command is sent."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from math import inf
from pathlib import Path

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, WRENCH_CHANNELS, Channel
from armdyn.run import Run, write_run_csv
from pipeline.imports.foreign import ForeignColumn, ImportedSampleCounts
from pipeline.imports.publishers import JOINT_STATE_QUANTITIES, REVOLUTE_UNITS, UNREADABLE_REASON, Publishers
from pipeline.interrupts import deferred_signals
from pipeline.loadcell.calibration import Calibration, default_calibration_path
from pipeline.loadcell.cell import LoadCell
from pipeline.robot.protocol import ForceSample
from pipeline.ros.bridge import Message, RosBridge
from pipeline.ros.states import FIRST_STATE_TIMEOUT_SECONDS, header_stamp, missing_state_error
from pipeline.ros.topics import RosTopics
from pipeline.ros.wrenches import WRENCH_TYPE, missing_wrench_error, wrench_values

MAX_STATE_GAP_SECONDS = 1.0
"""Longest time between two joint states before a recording ends [s]; long, because some drivers are slow."""


def record_run(
    uri: str,
    arm: urdf.Robot,
    topics: RosTopics,
    output: Path,
    seconds: float,
    port: str | None = None,
    calibration: Path | None = None,
    progress: Callable[[float], None] | None = None,
    wrenches: Mapping[str, str] | None = None,
) -> tuple[Run, tuple[str, ...]]:
    """Record joint states, wrenches and load cell of a robot for some seconds, and write them as a CSV file.

    Args:
        uri: address of the bridge.
        arm: description of the arm; if it has a line, the tool's coordinate and height are recorded too.
        topics: topics of the arm.
        output: file to write, with a TOML file of the same name beside it.
        seconds: duration [s]; a signal may end the recording earlier.
        port: serial port of the load cell; None for no load cell.
        calibration: calibration file of the load cell; None for the user's default one.
        progress: called with the finished share.
        wrenches: topics of force/torque sensors, by the name of the sensor.

    Returns:
        The recording, and sentences on messages and quantities that it lacks.

    Raises:
        InputError: no bridge, no states of these joints, no wrenches of a sensor, no load cell.
        TaskFailedError: messages stopped arriving; the earlier ones are written.
    """
    sensed = wrenches or {}
    heard = _ReceivedMessages(topics.joint_states, sensed.values())
    forces: list[ForceSample] = []
    used = Calibration.load(calibration or default_calibration_path()) if port is not None else None
    with ExitStack() as stack:
        bridge = stack.enter_context(RosBridge(uri))
        cell = stack.enter_context(LoadCell(port, used)) if port is not None and used is not None else None
        bridge.subscribe(topics.joint_states, "sensor_msgs/JointState", heard.take)
        for sensor, topic in sensed.items():
            bridge.subscribe(topic, WRENCH_TYPE, partial(heard.take_wrench, sensor, topic), every=True)
        heard.wait_for(arm.joint_names)
        if silent := heard.silent_wrenches():
            raise missing_wrench_error(bridge, silent)
        start, ended = time.monotonic(), ""
        heard.begin(start)
        signals: list[int] = []
        stack.enter_context(deferred_signals(signals.append))
        while not (ended or signals) and (elapsed := time.monotonic() - start) < seconds:
            time.sleep(min(0.05, seconds - elapsed))
            if bridge.failure is not None:
                ended = bridge.failure
            else:
                ended = next(
                    (
                        f"{topic}: nothing came for {MAX_STATE_GAP_SECONDS:g} s"
                        for topic, latest in heard.latest.items()
                        if time.monotonic() - max(latest, start) > MAX_STATE_GAP_SECONDS
                    ),
                    "",
                )
            if cell is not None:
                forces += cell.read()
            if progress is not None:
                progress(elapsed / seconds)
        faults = {} if cell is None else cell.status().counts
    said = [f"load cell, {count} times: {fault.value}" for fault, count in faults.items() if count]
    columns, account, notes = heard.columns()
    said += [account.sentence, *notes]
    if account.kept < MIN_COMPARED_CHANNEL_SAMPLES:
        raise TaskFailedError(f"{ended or 'it was ended'}; {account.sentence}: too few to be written")
    run = _run(arm, columns, forces, start, output, used, said)
    write_run_csv(run, output)
    told = f"the {max(c.time[-1] for c in run.channels.values()):.1f} s of {seconds:g} s that came are in {output}"
    if ended:
        raise TaskFailedError(f"{ended}; {told}")
    if signals:
        said.append(f"ended by a signal; {told}")
    return run, tuple(said)


class _ReceivedMessages:
    """Joint states of a topic, and wrenches of others, collected in the bridge's thread; any thread may read them.

    Attributes:
        latest: time of reception of the newest message of each topic, on our clock [s].
    """

    def __init__(self, topic: str, wrenches: Iterable[str]) -> None:
        self._topic = topic
        self._publishers = Publishers()
        self._unread = Counter[str]()
        self._names: dict[str, None] = {}
        self._changed = threading.Condition()
        self._start = inf
        self.latest = dict.fromkeys((topic, *wrenches), -inf)

    def take(self, message: Message, now: float) -> None:
        """Store one message that was received at a time of our clock [s]."""
        with self._changed:
            self.latest[self._topic] = now
            names = message.get("name")
            if isinstance(names, list) and all(isinstance(name, str) for name in names):
                self._names |= dict.fromkeys(names)
            self._changed.notify_all()
            if now < self._start:
                return
            try:
                stamp = header_stamp(message)
                values = {part: _numbers(message.get(part)) for part, _ in JOINT_STATE_QUANTITIES}
                self._publishers.add_joint_message(
                    self._topic, "", list(message["name"]), values, stamp if stamp > 0.0 else np.nan, now
                )
            except (KeyError, TypeError, ValueError):
                self._unread[self._topic] += 1

    def take_wrench(self, sensor: str, topic: str, message: Message, now: float) -> None:
        """Store one wrench of a sensor that was received at a time of our clock [s]."""
        with self._changed:
            self.latest[topic] = now
            self._changed.notify_all()
            if now < self._start:
                return
            values, stamp = wrench_values(message), header_stamp(message)
            if values is None:
                self._unread[topic] += 1
                return
            axes = zip(WRENCH_CHANNELS, values.tolist(), strict=True)
            named = [(f"{topic}/{axis}", value, f"{axis}.{sensor}") for axis, value in axes]
            self._publishers.take(topic, "", stamp if stamp > 0.0 else np.nan, now, named)

    def silent_wrenches(self) -> list[str]:
        """Topics of wrenches from which nothing came, after some time to wait for it."""
        with self._changed:
            self._changed.wait_for(lambda: min(self.latest.values()) > -inf, FIRST_STATE_TIMEOUT_SECONDS)
            return [topic for topic, latest in self.latest.items() if latest == -inf]

    def begin(self, start: float) -> None:
        """Begin to keep messages, from a time of our clock [s] on."""
        with self._changed:
            self._start = start

    def wait_for(self, names: Sequence[str]) -> None:
        """Wait until messages have named every one of these joints.

        Raises:
            InputError: a joint was never sent.
        """
        with self._changed:
            if self._changed.wait_for(lambda: set(names) <= self._names.keys(), FIRST_STATE_TIMEOUT_SECONDS):
                return
            missing = [name for name in names if name not in self._names]
            others = f"; what came is of {', '.join(self._names)}" if self._names else ""
        raise missing_state_error(self._topic, missing, others)

    def columns(self) -> tuple[dict[str, ForeignColumn], ImportedSampleCounts, list[str]]:
        """Kept messages as columns, with times on our clock, and an account of the joint states."""
        with self._changed:
            columns, accounts, notes = self._publishers.columns(self._unread, on_arrival=True)
        for topic in self.latest.keys() - accounts:
            unread = self._unread[topic]
            accounts[topic] = ImportedSampleCounts(topic, unread, 0, {UNREADABLE_REASON: unread})
        account = accounts.pop(self._topic)
        return columns, account, [*notes, *(other.sentence for other in accounts.values())]


def _numbers(values: object) -> list[float] | None:
    """The numbers of a message; entries that are not numbers become nan, which JSON lacks."""
    return [np.nan if value is None else float(value) for value in values] if isinstance(values, list) else None


def _run(
    arm: urdf.Robot,
    columns: Mapping[str, ForeignColumn],
    forces: list[ForceSample],
    start: float,
    output: Path,
    calibration: Calibration | None,
    said: list[str],
) -> Run:
    """The recorded run, whose times count from `start` [s], with notes on quantities that the robot did not send."""
    channels: dict[str, Channel] = {}
    sent = {column.channel: column for column in columns.values()}
    for quantity in ("q", "v", "tau"):
        missing = []
        for joint in arm.joint_names:
            column = sent.get(f"{quantity}.{joint}")
            present = np.isfinite(column.value) if column is not None else np.zeros(0, dtype=bool)
            silent = quantity == "tau" and column is not None and not column.value[present].any()
            if column is None or column.time is None or silent or present.sum() < MIN_COMPARED_CHANNEL_SAMPLES:
                missing.append(joint)
            else:
                channels[f"{quantity}.{joint}"] = Channel(
                    column.time[present] - start, column.value[present], REVOLUTE_UNITS[quantity]
                )
        if missing:
            said.append(f"no {quantity} of {', '.join(missing)} was sent")
    wrenches = {axis: kind.units[0] for axis, kind in WRENCH_CHANNELS.items()}
    for name, column in sent.items():
        if (unit := wrenches.get(name.partition(".")[0])) is not None and column.time is not None:
            channels[name] = Channel(column.time - start, column.value, unit)
    if forces:
        if arm.line_or_none is not None and all(f"q.{joint}" in channels for joint in arm.joint_names):
            time_of_states = channels[f"q.{arm.joint_names[0]}"].time
            q = [np.interp(time_of_states, c.time, c.value) for c in (channels[f"q.{j}"] for j in arm.joint_names)]
            along = np.array([arm.line.coordinates(arm.tool_pose(row).translation) for row in np.column_stack(q)])
            channels["gripper_x"] = Channel(time_of_states, along[:, 0], "m")
            channels["gripper_z"] = Channel(time_of_states, along[:, 1], "m")
        late = [sample for sample in forces if sample.time >= start]
        channels["load_force"] = Channel(
            np.array([sample.time - start for sample in late]), np.array([sample.force for sample in late]), "N"
        )
    noise = {"load_force": calibration.noise} if calibration is not None and forces else {}
    description = f"recorded from ROS, robot {arm.name}"
    return Run(output.name, channels, {}, noise, description, output)
