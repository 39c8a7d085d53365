"""Record samples to an MCAP file while a robot runs, and write a CSV and a TOML file at the end.

The MCAP file is flushed every half second of recording, so that a crash loses no more than that. Its layout is
described in `armdyn.recording.mcap_run`; the programs Foxglove and PlotJuggler can show it.
"""

import json
import math
from array import array
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from armdyn.atomic import CrashSafeGrowingFile
from armdyn.errors import InputError, UnknownNameError
from armdyn.recording.channels import Channel, is_channel_name, unit_conversion
from armdyn.recording.mcap_run import SIDECAR_RECORD, TIME_FIELD, topic_and_field
from armdyn.recording.sidecar import Sidecar, sidecar_text
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run, write_run_csv
from pipeline.processes import Closable

FLUSH_PERIOD_SECONDS = 0.5
"""Interval at which the MCAP file is flushed: the part of a recording that a crash may lose [s]."""
DROPPED_RECORD = "armdyn.dropped"
"""Name of the MCAP metadata record with the number of samples that were left out, by channel."""


class Recorder(Closable):
    """Writes one recording to files; use it in a ``with`` block, which closes the files also after an exception.

    The channels that models use (see `armdyn.recording.channels`) form the run; other channels, such as
    ``estimate.length``, are stored in the MCAP file only. A bad sample never stops a motion: a sample that is missing
    or infinite, or not later than the one before, is left out and counted in `dropped`. Neither does a full disk:
    `failure` then says what happened, nothing more is written, and the samples stay in memory.

    Args:
        path: the ``.mcap`` file; a CSV and a TOML file of the same stem are written beside it on closing.
        channels: unit of each channel that will be recorded; channels that models use are recorded in SI units.
        description: description of the recording, for a person.
        noise: standard deviation of the noise of channels, in the channel's unit, where known.
        known: values measured by hand, such as ``{"mass": Known(0.08, 0.0004, "kg")}``.

    Attributes:
        path: path of the MCAP file.
        dropped: number of samples that were left out, by channel.

    Raises:
        InputError: the file cannot be written, or a channel that models use is not in SI units.

    Example:
        >>> with Recorder(Path("trial.mcap"), {"gripper_x": "m", "load_force": "N"}) as recorder:  # doctest: +SKIP
        ...     recorder.record("load_force", time=0.01, value=0.785)
    """

    def __init__(
        self,
        path: Path | str,
        channels: Mapping[str, str],
        *,
        description: str = "",
        noise: Mapping[str, float] | None = None,
        known: Mapping[str, KnownQuantity] | None = None,
    ) -> None:
        self.path = Path(path)
        self.dropped: dict[str, int] = {}
        self._units = {name: _si(name, unit) for name, unit in channels.items()}
        for name in noise or {}:
            if name not in self._units:
                raise UnknownNameError("channel of the recording", name, self._units)
        self._description, self._noise, self._known = description, dict(noise or {}), dict(known or {})
        self._flushed_at = -math.inf
        self._samples = {name: array("d") for name in channels}  # time, value, time, value, ...
        self._place = {name: topic_and_field(name) for name in channels}
        self._pending: dict[str, dict[str, float]] = {}
        self._closed = False
        self._file = CrashSafeGrowingFile(self.path)
        self._writer = Writer(self._file.stream)
        try:
            self._begin()
        except OSError as error:
            raise InputError(f"cannot write {self.path}: {error.strerror or error}; choose another place") from error

    @property
    def failure(self) -> str | None:
        """Why the file could not be written any further; None while it can."""
        return self._file.failure

    def _begin(self) -> None:
        self._writer.start(profile="armdyn", library="armdyn")
        self._topic_id = self._register_topics()
        sidecar = Sidecar(
            self._description,
            {n: KnownQuantity(std, None, self._units[n]) for n, std in self._noise.items()},
            self._known,
        )
        self._writer.add_metadata(SIDECAR_RECORD, {"toml": sidecar_text(sidecar)})
        self._writer.flush()

    def record(self, channel: str, time: float, value: float) -> None:
        """Record one sample.

        Args:
            channel: name of one of the channels given at the start.
            time: time on the run's clock [s].
            value: value in the channel's unit.

        Raises:
            UnknownNameError: the channel was not given at the start.
            ValueError: the recorder is closed.
        """
        if self._closed:
            raise ValueError(f"the recording {self.path} is closed")
        if channel not in self._units:
            raise UnknownNameError("channel of the recording", channel, self._units)
        samples = self._samples[channel]
        time, value = float(time), float(value)
        if not (math.isfinite(time) and math.isfinite(value)) or (samples and time <= samples[-2]):
            self.dropped[channel] = self.dropped.get(channel, 0) + 1
            return
        samples.extend((time, value))  # in one step: Ctrl-C cannot come between the two
        if self.failure is not None:
            return
        try:
            self._write(channel, time, value)
        except OSError as error:
            self._file.fail(error)

    def _write(self, channel: str, time: float, value: float) -> None:
        if time - self._flushed_at >= FLUSH_PERIOD_SECONDS:
            self.flush()
            self._flushed_at = time
        topic, field = self._place[channel]
        message = self._pending.get(topic)
        if message is not None and message[TIME_FIELD] != time:
            self._emit(topic)
            message = None
        if message is None:
            message = self._pending[topic] = {TIME_FIELD: time}
        message[field] = value

    def channel(self, name: str) -> Channel:
        """The samples of a channel that were recorded so far.

        Raises:
            UnknownNameError: the channel was not given at the start.
        """
        if name not in self._units:
            raise UnknownNameError("channel of the recording", name, self._units)
        samples = np.array(self._samples[name])
        return Channel(samples[::2], samples[1::2], self._units[name])

    def run(self) -> Run:
        """The run that was recorded so far, with the channels that models use and that have samples."""
        channels = {name: self.channel(name) for name in self._units if self._samples[name] and is_channel_name(name)}
        warnings = tuple(
            f"{name}: {count} samples left out (missing, infinite, or not later than the one before)"
            for name, count in self.dropped.items()
        ) + ((self.failure,) if self.failure else ())
        noise = {name: std for name, std in self._noise.items() if name in channels}
        return Run(self.path.name, channels, self._known, noise, self._description, self.path, warnings)

    def flush(self) -> None:
        """Write all samples to the file, so that a crash of this program does not lose them."""
        for topic in tuple(self._pending):
            self._emit(topic)
        self._writer.flush()

    def close(self) -> Run:
        """Finish the MCAP file, write the CSV and TOML files if there are samples, and return the run.

        A second call only returns the run.

        Raises:
            InputError: the CSV or TOML file cannot be written; the MCAP file is complete, unless `failure` is set.
        """
        run = self.run()
        if not self._closed:
            self._closed = True
            self._finish_file()
            if run.channels:
                write_run_csv(run, self.path.with_suffix(".csv"))
        return run

    def _finish_file(self) -> None:
        try:
            self.flush()
            if self.dropped:
                self._writer.add_metadata(DROPPED_RECORD, {name: str(count) for name, count in self.dropped.items()})
            self._writer.finish()
        except OSError as error:
            self._file.fail(error)
        self._file.finish()

    def _register_topics(self) -> dict[str, int]:
        """Register a topic per group of channels, with a JSON schema that names each field's channel and unit."""
        fields: dict[str, dict[str, str]] = {}
        for name, (topic, field) in self._place.items():
            taken = fields.setdefault(topic, {})
            if field == TIME_FIELD or field in taken:
                raise InputError(
                    f"channel '{name}' cannot be recorded: its field '{field}' of {topic} is taken; rename it"
                )
            taken[field] = f"{name} [{self._units[name]}]"
        ids = {}
        for topic, labels in fields.items():
            properties = {TIME_FIELD: {"type": "number", "description": "time [s]"}}
            properties |= {field: {"type": "number", "description": label} for field, label in labels.items()}
            title = f"armdyn{topic.replace('/', '.')}"
            schema = {"title": title, "type": "object", "properties": properties, "required": [TIME_FIELD]}
            schema_id = self._writer.register_schema(title, "jsonschema", json.dumps(schema).encode())
            ids[topic] = self._writer.register_channel(topic, "json", schema_id, labels)
        return ids

    def _emit(self, topic: str) -> None:
        message = self._pending.pop(topic)
        stamp = max(0, round(message[TIME_FIELD] * 1e9))  # MCAP counts nanoseconds from zero up
        self._writer.add_message(self._topic_id[topic], stamp, json.dumps(message).encode(), stamp)


def _si(name: str, unit: str) -> str:
    """The unit of a channel; for a channel that models use, it must be the SI unit."""
    if not is_channel_name(name):
        return unit
    to_si = unit_conversion(name, unit)
    if to_si != (to_si.unit, 1.0, 0.0):
        raise InputError(f"channel '{name}' is recorded in {to_si.unit}, not in {unit}: convert it first")
    return to_si.unit
