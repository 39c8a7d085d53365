"""Sources of an arm's samples (time, positions, torques): recordings, or CSV lines on standard input."""

import io
import math
import os
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
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
from urdf.bounds import parse_number

RECORDING_SUFFIXES = (".csv", ".mcap")
MAX_QUEUED_SAMPLES = 2000
"""Largest number of buffered samples, 2 s at 1 kHz; a new one of ROS then replaces the oldest one."""
WAIT_SECONDS = 0.1
"""Time after which a source that gives no sample says so [s]."""
MAX_LINE_CHARACTERS = 2**20
"""Largest length of a line of standard input; a sample of 100 joints has 5000 characters."""
BYTE_ORDER_MARK = "\ufeff"


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
    waiting: queue.Queue[str | Exception] = queue.Queue(MAX_QUEUED_SAMPLES)

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
