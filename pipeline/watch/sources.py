"""Sources of an arm's samples (time, positions, torques): recordings, CSV lines on standard input, or ROS topics."""

import math
import queue
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray, name_and_unit, unit_conversion
from armdyn.run import Run, read_run
from armdyn.watch.fault_free import JointSample, joint_samples_of_recording
from pipeline.interrupts import deferred_signals
from pipeline.ros.bridge import Message, RosBridge
from pipeline.ros.states import FIRST_STATE_TIMEOUT_SECONDS, JointStateBuffer, missing_state_error

RECORDING_SUFFIXES = (".csv", ".mcap")
MAX_QUEUED_JOINT_STATES = 2000
"""Largest number of buffered joint states, 2 s at 1 kHz; a new state then replaces the oldest one."""
RECONNECT_PERIOD_SECONDS = 1.0
"""Time between attempts to connect to a lost bridge again [s]."""


def recordings_in(paths: Sequence[Path]) -> list[Path]:
    """All files of `paths`, where a folder stands for the recordings in it, sorted by name.

    Raises:
        InputError: a folder contains no recording.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix in RECORDING_SUFFIXES)
            if not inside:
                raise InputError(f"{path}: holds no recording, {' or '.join(RECORDING_SUFFIXES)}")
            found += inside
        else:
            found.append(path)
    return found


def read_arm_runs(model: ArmModel, paths: Sequence[Path]) -> list[Run]:
    """Read recordings of the model's arm; for servo motors torques are computed from position or velocity errors."""
    return [model.with_estimated_channels(read_run(path)) for path in paths]


def sample_sources(model: ArmModel, runs: Sequence[Run]) -> list[Callable[[], Iterator[JointSample]]]:
    """One function for each run, whose call returns an iterator over all samples of the run."""
    return [partial(joint_samples_of_recording, run, model) for run in runs]


def samples_from_lines(stream: TextIO, model: ArmModel, name: str = "standard input") -> Iterator[JointSample]:
    """Samples from lines of CSV, whose first line names the columns: ``time [s],q.elbow [rad],...``.

    Lines that are malformed or lack a value are skipped.

    Args:
        stream: the lines.
        model: model of the arm, which names the joints.
        name: name of the stream for error messages.

    Raises:
        InputError: the first line lacks the time, a position or a torque.
    """
    heads = [name_and_unit(cell) for cell in stream.readline().strip().split(",")]
    index = {head: i for i, (head, _) in enumerate(heads)}
    joints = model.arm.joints
    wanted = ["time", *(f"q.{joint}" for joint in joints), *(f"tau.{joint}" for joint in model.joints)]
    missing = [head for head in wanted if head not in index]
    if missing:
        raise InputError(
            f"{name}: its first line has no {', '.join(missing)}: write the heads of a recording, time [s], q.<joint> "
            "[rad] and tau.<joint> [N m] of every joint"
        )
    units = {head: unit_conversion(head, heads[index[head]][1]) for head in wanted if heads[index[head]][1]}
    for line in stream:
        cells = line.strip().split(",")
        try:
            value = {
                head: float(cells[index[head]]) * (units[head].factor if head in units else 1.0) for head in wanted
            }
        except (ValueError, IndexError):
            continue
        q = np.array([value[f"q.{joint}"] for joint in joints])
        yield value["time"], q, np.array([value.get(f"tau.{joint}", 0.0) for joint in joints])


class RosSampleSource:
    """Source of samples from the joint states of a robot behind rosbridge; it sends nothing to the robot.

    After a lost connection it connects again; the samples between are missing.

    Args:
        uri: address of the bridge.
        topic: topic of the joint states.
        names: names of the arm's joints.
    """

    def __init__(self, uri: str, topic: str, names: Sequence[str]) -> None:
        self._uri, self._topic, self._names = uri, topic, tuple(names)
        self._waiting: queue.Queue[JointSample] = queue.Queue(MAX_QUEUED_JOINT_STATES)
        self._ended = False

    def samples(self) -> Iterator[JointSample]:
        """Samples until a signal (SIGINT, SIGTERM) arrives, with times since the first sample on this computer's clock.

        Raises:
            InputError: no connection, no states of these joints, or states without torques.
        """
        with ExitStack() as stack:
            stack.enter_context(deferred_signals(lambda _: setattr(self, "_ended", True)))
            bridge = stack.enter_context(self._connected())
            start, begun, torques = None, time.monotonic(), False
            while not self._ended:
                try:
                    stamp, q, tau = self._waiting.get(timeout=0.1)
                except queue.Empty:
                    if bridge.failure is not None:
                        bridge = self._reconnected(stack) or bridge
                    elif start is None and time.monotonic() - begun > FIRST_STATE_TIMEOUT_SECONDS:
                        raise missing_state_error(self._topic, self._names) from None
                    continue
                torques = torques or bool(np.isfinite(tau).all())
                if not torques and time.monotonic() - begun > FIRST_STATE_TIMEOUT_SECONDS:
                    raise InputError(f"{self._topic}: no efforts are sent: a watch needs the torques of the joints")
                start = stamp if start is None else start
                yield stamp - start, q, tau

    def _connected(self) -> RosBridge:
        bridge, joints, newest = RosBridge(self._uri), JointStateBuffer(self._names), [-math.inf]

        def take(message: Message, now: float) -> None:
            joints.take(message, now)
            state = joints.latest
            if state is not None and state.time > newest[0]:
                newest[0] = state.time
                self._put((state.time, np.array(state.q), np.array(state.tau)))

        bridge.subscribe(self._topic, "sensor_msgs/JointState", take, every=True)
        return bridge

    def _put(self, sample: tuple[float, FloatArray, FloatArray]) -> None:
        while True:
            try:
                return self._waiting.put_nowait(sample)
            except queue.Full:
                self._waiting.get_nowait()

    def _reconnected(self, stack: ExitStack) -> RosBridge | None:
        time.sleep(RECONNECT_PERIOD_SECONDS)
        try:
            return stack.enter_context(self._connected())
        except InputError:
            return None
