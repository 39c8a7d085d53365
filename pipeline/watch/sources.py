"""Sources of an arm's samples (time, positions, torques): recordings, CSV lines on standard input, or ROS topics."""

import io
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError, error_location
from armdyn.recording.channels import Conversion, FloatArray
from armdyn.recording.checks import MIN_SAMPLE_INTERVAL_SECONDS, check_stamps
from armdyn.recording.csv_run import header_columns
from armdyn.run import Run, read_run
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.fault_free import JointSample, joint_samples_of_recording
from armdyn.watch.observer import INTERVALS_FOR_SAMPLING_RATE, MAX_SAMPLE_GAP_SECONDS
from pipeline.interrupts import deferred_signals
from pipeline.ros.bridge import Message, RosBridge
from pipeline.ros.states import FIRST_STATE_TIMEOUT_SECONDS, JointStateBuffer, missing_state_error
from urdf.bounds import parse_number

RECORDING_SUFFIXES = (".csv", ".mcap")
MAX_QUEUED_JOINT_STATES = 2000
"""Largest number of buffered joint states, 2 s at 1 kHz; a new state then replaces the oldest one."""
WAIT_SECONDS = 0.1
"""Time after which a source that gives no sample says so [s]."""
MAX_LINE_CHARACTERS = 2**20
"""Largest length of a line of standard input; a sample of 100 joints has 5000 characters."""
BYTE_ORDER_MARK = "\ufeff"
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
    """Read recordings of the model's arm; for servo motors torques are computed from position or velocity errors.

    Raises:
        InputError: a recording cannot be read, or its times cannot be those of samples.
    """
    runs = [model.with_estimated_channels(read_run(path)) for path in paths]
    for path, run in zip(paths, runs, strict=True):
        with error_location(path):
            check_stamps(run)
            for channel in run.channels.values():
                if len(channel) > 1:
                    check_sampling(channel.time)
    return runs


def sample_sources(
    model: ArmModel, runs: Sequence[Run], channels: WatchedChannels
) -> list[Callable[[], Iterator[JointSample]]]:
    """One function for each run, whose call returns an iterator over all samples of some channels of the run."""
    return [partial(joint_samples_of_recording, run, model, channels) for run in runs]


def check_sampling(time: FloatArray) -> None:
    """Refuse times of samples, s, from which no motion can be seen.

    Raises:
        InputError: the samples are too rare, or so frequent that the unit of time is wrong.
    """
    step = float(np.median(np.diff(time)))
    if not step > MIN_SAMPLE_INTERVAL_SECONDS:
        raise InputError(
            f"time: a sample every {step:.3g} s, which no sensor does: check the unit of 'time', such as 'time [s]'"
        )
    if step > MAX_SAMPLE_GAP_SECONDS:
        raise InputError(
            f"time: a sample every {step:.3g} s where a watch needs one every {MAX_SAMPLE_GAP_SECONDS:g} s: check the "
            "unit of 'time', such as 'time [ms]', or record more often"
        )


def samples_from_lines(
    stream: TextIO, channels: WatchedChannels, name: str = "standard input", ended: threading.Event | None = None
) -> Iterator[JointSample | None]:
    """Samples from lines of CSV, whose first line names the columns: ``time [s],q.elbow [rad],...``.

    Values that are missing or cannot be read are nan; None stands for a while without a line.

    Args:
        stream: the lines.
        channels: the channels.
        name: name of the stream for error messages.
        ended: set by a signal, which ends the samples.

    Raises:
        InputError: the lines are not those of a recording of this arm, as in a file.
    """
    joints, read = (
        channels.joints,
        [name for name, is_asked in zip(channels.names, channels.asked, strict=True) if is_asked],
    )
    wanted = ["time", *(f"q.{joint}" for joint in joints), *read]
    cells: list[int] = []
    conversions: list[Conversion] = []
    width, times = 0, list[float]()
    with error_location(name):
        for line in _lines(stream, threading.Event() if ended is None else ended):
            if line is None:
                yield None
                continue
            if not conversions:
                if line.strip():
                    columns = header_columns(line.strip().removeprefix(BYTE_ORDER_MARK))
                    missing = [head for head in wanted if head not in columns]
                    if missing:
                        sensed = "".join(f", and fx.{name} [N] to tz.{name} [N m]" for name in channels.sensors)
                        raise InputError(
                            f"its first line has no {', '.join(missing)}: write the heads of a recording, time [s], "
                            f"q.<joint> [rad] and tau.<joint> [N m] of every joint{sensed}"
                        )
                    cells, conversions = [[*columns].index(head) for head in wanted], [columns[one] for one in wanted]
                    width = len(columns)
                continue
            parts = line.split(",")
            if not times and len(parts) != width:
                raise InputError(
                    f"a line of {len(parts)} cells follows {width} heads: write commas between the cells, and decimal "
                    "points"
                )
            values = np.array([_number(parts[cell]) if cell < len(parts) else np.nan for cell in cells])
            values = np.array([to_si(value) for to_si, value in zip(conversions, values, strict=True)])
            if len(times) <= INTERVALS_FOR_SAMPLING_RATE and np.isfinite(values[0]):
                times.append(float(values[0]))
                if len(times) > INTERVALS_FOR_SAMPLING_RATE:
                    check_sampling(np.array(times))
            tau = np.zeros(len(channels.names))
            tau[channels.asked] = values[1 + len(joints) :]
            yield float(values[0]), values[1 : 1 + len(joints)], tau


def _number(cell: str) -> float:
    try:
        return parse_number(cell.strip())
    except ValueError:
        return math.nan


def _lines(stream: TextIO, ended: threading.Event) -> Iterator[str | None]:
    """Lines of a stream until it ends or a signal sets `ended`; None where none came for `WAIT_SECONDS`."""
    waiting: queue.Queue[str | Exception] = queue.Queue(MAX_QUEUED_JOINT_STATES)

    def read() -> None:
        try:
            # A thread of its own must not hold the lock of the interpreter's stream when the program ends.
            with os.fdopen(os.dup(stream.fileno()), encoding="utf-8-sig") as own:
                _pass_on(own, waiting)
        except io.UnsupportedOperation:  # a stream in memory
            _pass_on(stream, waiting)
        except (OSError, UnicodeError) as error:
            waiting.put(InputError(f"it cannot be read as text ({error}): write CSV as UTF-8"))

    with deferred_signals(lambda _: ended.set()):
        threading.Thread(target=read, daemon=True, name="lines").start()
        while not ended.is_set():
            try:
                line = waiting.get(timeout=WAIT_SECONDS)
            except queue.Empty:
                yield None
                continue
            if isinstance(line, Exception):
                raise line
            if not line:
                return
            yield line


def _pass_on(stream: TextIO, waiting: "queue.Queue[str | Exception]") -> None:
    while line := stream.readline(MAX_LINE_CHARACTERS):
        if len(line) == MAX_LINE_CHARACTERS:
            waiting.put(InputError(f"a line has more than {MAX_LINE_CHARACTERS} characters: end each sample by a line"))
            return
        waiting.put(line)
    waiting.put("")


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

    def samples(self) -> Iterator[JointSample | None]:
        """Samples until a signal (SIGINT, SIGTERM) arrives, with times since the first sample on this computer's clock.

        None stands for a while without one; a state that cannot be read has the value nan throughout.

        Raises:
            InputError: no connection, no states of these joints, or states without torques.
        """
        with ExitStack() as stack:
            stack.enter_context(deferred_signals(lambda _: setattr(self, "_ended", True)))
            bridge = stack.enter_context(self._connected())
            start, begun, torques = None, time.monotonic(), False
            while not self._ended:
                try:
                    stamp, q, tau = self._waiting.get(timeout=WAIT_SECONDS)
                except queue.Empty:
                    if start is not None:
                        yield None
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
            unreadable = joints.unreadable
            joints.take(message, now)
            if joints.unreadable > unreadable and newest[0] > -math.inf:
                nothing = np.full(len(self._names), np.nan)
                self._put((now, nothing, nothing))
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
