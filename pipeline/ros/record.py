"""Record joint states and load cell of a ROS robot; no command is sent."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, Channel
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
) -> tuple[Run, tuple[str, ...]]:
    """Record joint states and load cell of a robot for some seconds, and write the recording as a CSV file.

    Args:
        uri: address of the bridge.
        arm: description of the arm; if it has a line, the tool's coordinate and height are recorded too.
        topics: topics of the arm.
        output: file to write, with a TOML file of the same name beside it.
        seconds: duration [s]; a signal may end the recording earlier.
        port: serial port of the load cell; None for no load cell.
        calibration: calibration file of the load cell; None for the user's default one.
        progress: called with the finished share.

    Returns:
        The recording, and sentences on messages and quantities that it lacks.

    Raises:
        InputError: no bridge, no states of these joints, no load cell.
        TaskFailedError: messages stopped arriving; the earlier ones are written.
    """
    heard = _ReceivedStates(topics.joint_states)
    forces: list[ForceSample] = []
    used = Calibration.load(calibration or default_calibration_path()) if port is not None else None
    with ExitStack() as stack:
        bridge = stack.enter_context(RosBridge(uri))
        cell = stack.enter_context(LoadCell(port, used)) if port is not None and used is not None else None
        bridge.subscribe(topics.joint_states, "sensor_msgs/JointState", heard.take)
        heard.wait_for(arm.joint_names)
        start, ended = time.monotonic(), ""
        heard.begin(start)
        signals: list[int] = []
        stack.enter_context(deferred_signals(signals.append))
        while not (ended or signals) and (elapsed := time.monotonic() - start) < seconds:
            time.sleep(min(0.05, seconds - elapsed))
            if bridge.failure is not None:
                ended = bridge.failure
            elif time.monotonic() - max(heard.latest, start) > MAX_STATE_GAP_SECONDS:
                ended = f"{topics.joint_states}: nothing came for {MAX_STATE_GAP_SECONDS:g} s"
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


class _ReceivedStates:
    """Joint states of a topic collected in the bridge's thread; any thread may read them.

    Attributes:
        latest: time of reception of the newest message, on our clock [s].
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._publishers = Publishers()
        self._unread = Counter[str]()
        self._names: dict[str, None] = {}
        self._changed = threading.Condition()
        self._start = inf
        self.latest = -inf

    def take(self, message: Message, now: float) -> None:
        """Store one message that was received at a time of our clock [s]."""
        with self._changed:
            self.latest = now
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
        """Kept joint states as columns, with times on our clock."""
        with self._changed:
            columns, accounts, notes = self._publishers.columns(self._unread, on_arrival=True)
        unread = self._unread[self._topic]
        return (
            columns,
            accounts.get(self._topic, ImportedSampleCounts(self._topic, unread, 0, {UNREADABLE_REASON: unread})),
            notes,
        )


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
