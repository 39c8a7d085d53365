"""A run: one recording, read from CSV or MCAP, in SI units, ready for comparison with a model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from armdyn import atomic
from armdyn.arrays import channels_from_arrays, time_and_columns_of_frame
from armdyn.displayable import Displayable
from armdyn.document import Column, Curve, Document, Section, Table, attribute_columns
from armdyn.errors import InputError, UnknownNameError
from armdyn.recording.bytes_in import directory_in_place_of_a_run
from armdyn.recording.channels import (
    MIN_COMPARED_CHANNEL_SAMPLES,
    Channel,
    channel_kind,
    check_joint_units,
    is_auxiliary,
    is_channel_name,
)
from armdyn.recording.csv_run import csv_text, read_csv
from armdyn.recording.preparation import Preparation
from armdyn.recording.sidecar import Sidecar, read_sidecar, sidecar_text
from armdyn.recording.units import KnownQuantity

__all__ = ["Channel", "KnownQuantity", "Run", "read_run", "write_run_csv"]


@dataclass(frozen=True, eq=False, repr=False)
class Run(Displayable):
    """One recording of a robot: time series of measured quantities in SI units; its arrays are read-only.

    Attributes:
        name: the file's name, such as ``"a.csv"``.
        channels: measured quantities by name, each with its own time stamps. Those named ``"extra.<name>"`` are moved
            to `extra`.
        known: values measured by hand (``mass``, ``length``, ...), in SI units; a fit uses them as priors.
        noise: standard deviation per channel, in the channel's unit, where known.
        description: a sentence for a reader.
        source: the file it came from; None where it was made in memory.
        warnings: a sentence for everything that was lost, such as the end of a recording that was cut off.
        began: start time, s, of the recording of which this run is a piece, or of the first of several recordings that
            share a clock; None where it stands alone.
        outliers: number of samples that were left out as faulty, by channel.
        spread: variance, s^2, of the instants over which samples are means, by channel. Such a mean differs from the
            signal by half of its second derivative times the variance.
        recorded: date and time of the recording, UTC; None where it is unknown.
        asked: questions that the import from a foreign format could not answer, by channel or ``"time"``, such as an
            uncertain unit.
        extra: further quantities by name, such as ``"extra.temperature"``, on which a force may depend; they are not
            compared with predictions, so any sampling rate will do.
        base_channels: names of further quantities, in `channels`, that a user's own base model predicts or needs.

    Raises:
        InputError: a joint is revolute in one channel and prismatic in another.
        UnknownNameError: a channel's name is not in the contract.
    """

    name: str
    channels: Mapping[str, Channel]
    known: Mapping[str, KnownQuantity] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    description: str = ""
    source: Path | None = None
    warnings: tuple[str, ...] = ()
    began: float | None = field(default=None, kw_only=True)
    outliers: Mapping[str, int] = field(default_factory=dict, kw_only=True)
    spread: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    recorded: datetime | None = field(default=None, kw_only=True)
    asked: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    extra: Mapping[str, Channel] = field(default_factory=dict, kw_only=True)
    base_channels: frozenset[str] = field(default=frozenset(), kw_only=True)

    def __post_init__(self) -> None:
        for name in self.channels:
            channel_kind(name)
        further = {n: c for n, c in self.channels.items() if is_auxiliary(n) and n not in self.base_channels}
        kept = {n: c for n, c in self.extra.items() if n not in self.base_channels}
        object.__setattr__(self, "extra", {**kept, **further})
        object.__setattr__(self, "channels", {n: c for n, c in self.channels.items() if n not in further})
        check_joint_units((name, channel.unit) for name, channel in self.channels.items())
        for attribute in ("channels", "known", "noise", "outliers", "spread", "asked", "extra"):
            object.__setattr__(self, attribute, MappingProxyType(dict(getattr(self, attribute))))

    @classmethod
    def from_arrays(
        cls,
        time: npt.ArrayLike,
        values: Mapping[str, npt.ArrayLike],
        *,
        units: Mapping[str, str] | None = None,
        joints: Sequence[str] = (),
        name: str = "run",
        known: Mapping[str, KnownQuantity] | None = None,
        noise: Mapping[str, float] | None = None,
        description: str = "",
    ) -> "Run":
        """Make a run from arrays that share their time stamps.

        ``Run.from_arrays(t, {"q": q, "tau": tau}, joints=["shoulder", "elbow"], units={"q": "deg"})``

        Args:
            time: (n,) time stamps, s, strictly increasing.
            values: (n,) samples by channel, with nan for missing samples; ``"q"``, ``"v"``, ``"a"`` and ``"tau"`` may
                have (n, j), a column for each of `joints`. A name may end in a unit: ``"load_force [mN]"``.
            units: units by channel, or by ``"q"``, ``"v"``, ``"a"``, ``"tau"``; by default SI.
            joints: names of the columns of two-dimensional values.
            name: name of the run.
            known: values measured by hand; see `Run`.
            noise: standard deviation per channel; see `Run`.
            description: a sentence for a reader; see `Run`.

        Raises:
            InputError: the arrays cannot be used; the message lists all faults.
        """
        channels = channels_from_arrays(time, values, units or {}, joints)
        return cls(name, channels, known or {}, noise or {}, description)

    @classmethod
    def from_dataframe(
        cls, frame: Any, *, units: Mapping[str, str] | None = None, name: str = "run", description: str = ""
    ) -> "Run":
        """Make a run from a data frame (pandas, polars, pyarrow); columns are channels: ``q.elbow``, ``q.elbow [deg]``.

        Args:
            frame: frame with a column ``time``, in s, or a pandas frame whose index is the time.
            units: units by column, where they are neither in the name nor SI.
            name: name of the run.
            description: a sentence for a reader; see `Run`.

        Raises:
            InputError: the frame cannot be used; the message lists all faults.
        """
        time, values = time_and_columns_of_frame(frame)
        return cls.from_arrays(time, values, units=units, name=name, description=description)

    def __reduce__(self) -> tuple[Callable[..., "Run"], tuple[()]]:
        # A MappingProxyType cannot be pickled, and runs go to other processes.
        values: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)}
        plain: dict[str, Any] = {name: dict(v) if isinstance(v, MappingProxyType) else v for name, v in values.items()}
        return partial(type(self), **plain), ()

    def __str__(self) -> str:
        """The run's name, its channels and its duration, in one line."""
        document = self.document()
        return f"{document.title}: {document.verdict}"

    __repr__ = __str__

    def document(self) -> Document:
        """Build the table of channels, and the curves over time: a row for each quantity, a curve for each joint."""
        channels, values = self.all_channels, self.all_channels.values()
        seconds = max((float(c.time[-1] - c.time[0]) for c in values), default=0.0)
        described = f"{self.description}. " if self.description else ""
        columns = [
            Column("channel", list(channels)),
            *attribute_columns(values, unit=""),
            Column("samples", [len(c) for c in values]),
            Column("from [s]", [float(c.time[0]) for c in values]),
            Column("to [s]", [float(c.time[-1]) for c in values]),
            Column("lowest", [float(c.value.min()) for c in values]),
            Column("highest", [float(c.value.max()) for c in values]),
        ]
        return Document(
            f"Run {self.name}",
            f"{described}{self.summary}, {seconds:.4g} s",
            [Section("Channels", tables=[Table(columns, name="channels")])],
            data={"samples": self._samples},
            curves=self._curves,
            default_table="samples",
        )

    @property
    def all_channels(self) -> Mapping[str, Channel]:
        """All recorded quantities by name: `channels` and `extra`."""
        return {**self.channels, **self.extra}

    @property
    def summary(self) -> str:
        """Kinds of channels and number of joints, such as ``"q, tau of 6 joints"``."""
        quantities = dict.fromkeys(name.partition(".")[0] for name in self.channels)
        of_joints = f" of {len(self.joints)} joints" if self.joints else ""
        return ", ".join(filter(None, (f"{', '.join(quantities)}{of_joints}", *self.extra))) or "nothing"

    def _samples(self) -> dict[str, list[Any]]:
        """Table with a row per time stamp and a column per channel; nan where a channel has no sample."""
        time = np.unique(np.concatenate([c.time for c in self.all_channels.values()]))
        columns: dict[str, list[Any]] = {"time": time.tolist()}
        for name, c in self.all_channels.items():
            column = np.full(len(time), np.nan)
            column[np.searchsorted(time, c.time)] = c.value
            columns[f"{name} [{c.unit}]"] = column.tolist()
        return columns

    def _curves(self) -> list[Curve]:
        parts = [(*name.partition("."), c) for name, c in self.all_channels.items()]
        return [Curve(f"{quantity} [{c.unit}]", joint or quantity, c.time, c.value) for quantity, _, joint, c in parts]

    @property
    def recording(self) -> "Run":
        """The recording at its original sampling rate: this run itself, unless a model has prepared it."""
        return self

    @property
    def preparations(self) -> Mapping[str, Preparation]:
        """How a model has processed channels for the comparison, by channel; empty where it uses them as recorded."""
        return {}

    @property
    def predictable_channels(self) -> tuple[str, ...]:
        """Names of the channels that a model can predict: force, swing angle and rate, joint torques."""
        return tuple(name for name in self.channels if channel_kind(name).measured)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose positions were recorded, in the order of the columns."""
        return tuple(name.removeprefix("q.") for name in self.channels if name.startswith("q."))

    def channel(self, name: str) -> Channel:
        """The channel `name`.

        Raises:
            UnknownNameError: this run does not have the channel.
        """
        if name not in self.all_channels:
            raise UnknownNameError(f"channel of {self.name}", name, self.all_channels)
        return self.all_channels[name]

    def require_varying_channel(self, name: str) -> Channel:
        """The channel `name`, which must have enough samples and must change.

        Raises:
            UnknownNameError: this run does not have the channel.
            InputError: it has fewer than `MIN_COMPARED_CHANNEL_SAMPLES` samples, or it is constant.
        """
        channel = self.channel(name)
        if len(channel) < MIN_COMPARED_CHANNEL_SAMPLES:
            raise InputError(
                f"{self._where}: '{name}' has {len(channel)} samples, "
                f"at least {MIN_COMPARED_CHANNEL_SAMPLES} are needed: record longer"
            )
        span = float(np.ptp(channel.value))
        # A constant in another unit may differ by one rounding.
        if span <= 1e-14 * float(np.abs(channel.value).max()):
            raise InputError(
                f"{self._where}: '{name}' is {channel.value[0]:.6g} {channel.unit} throughout: "
                "check that the sensor was connected, or leave the channel out"
            )
        return channel

    @property
    def _where(self) -> str:
        return str(self.source) if self.source is not None else self.name


def read_run(path: Path | str, recover: bool = False) -> Run:
    """Read a recording: a CSV with its sidecar ``<same stem>.toml``, or an ``.mcap``.

    Missing samples (empty cells, ``nan``) are dropped per channel; every channel is converted to SI units.

    Args:
        path: ends in ``.mcap``, or is a CSV.
        recover: read an MCAP file that was cut off as far as it goes, with a warning in `Run.warnings`.

    Raises:
        InputError: the file is not valid; the message names the file, the row or column, the mistake and a remedy.
    """
    path = Path(path)
    if path.is_dir():  # also ".", which has no suffix to change
        raise InputError(directory_in_place_of_a_run(path))
    warnings: tuple[str, ...] = ()
    sidecar_path = path.with_suffix(".toml")
    if path.suffix.lower() == ".mcap":
        from armdyn.recording.mcap_run import read_mcap

        recording = read_mcap(path, recover)
        channels, warnings = _of_the_contract(path, recording.channels), recording.warnings
        sidecar = read_sidecar(sidecar_path) if sidecar_path.exists() else recording.sidecar
    elif path.suffix.lower() == ".toml":
        raise InputError(f"{path}: describes a recording and is none: give the .csv or .mcap beside it")
    else:
        channels, sidecar = read_csv(path), read_sidecar(sidecar_path)
    for name, std in sidecar.noise.items():
        if name in channels and channels[name].unit != std.unit:
            raise InputError(
                f"{sidecar_path}: [noise] {name}: is in {std.unit} where the recording is in {channels[name].unit}: "
                "write both in the same kind of unit"
            )
    return Run(
        name=path.name,
        channels=channels,
        known=sidecar.known,
        noise={name: std.value for name, std in sidecar.noise.items()},
        description=sidecar.description,
        source=path,
        warnings=warnings,
        recorded=sidecar.recorded,
        asked=sidecar.asked,
    )


def write_run_csv(run: Run, path: Path | str) -> None:
    """Write a run as CSV and sidecar; `read_run` reads the same numbers to the last digit.

    Channels with different stamps are merged by time, with empty cells where one has no sample. Either both files are
    replaced or none.

    Raises:
        InputError: the run has no channel, or the files cannot be written.
    """
    path = Path(path)
    if not run.all_channels:
        raise InputError(f"{run.name}: nothing was recorded, so there is nothing to write to {path}")
    units = {
        name: run.all_channels[name].unit if name in run.all_channels else channel_kind(name).units[0]
        for name in run.noise
    }
    noise = {name: KnownQuantity(std, None, units[name]) for name, std in run.noise.items()}
    sidecar = sidecar_text(Sidecar(run.description, noise, run.known, run.recorded, run.asked))
    with atomic.replace_two_files(path.with_suffix(".toml"), path) as files:
        for file, text in zip(files, (sidecar, csv_text(run.all_channels)), strict=True):
            file.write(text.encode("utf-8", errors="replace"))


def _of_the_contract(path: Path, recorded: Mapping[str, Channel]) -> dict[str, Channel]:
    """The channels of a run among all that were recorded."""
    channels = {name: channel for name, channel in recorded.items() if is_channel_name(name)}
    longest = max(map(len, channels.values()), default=0)
    if longest < MIN_COMPARED_CHANNEL_SAMPLES:
        raise InputError(
            f"{path}: holds {longest} samples where at least {MIN_COMPARED_CHANNEL_SAMPLES} are needed: record longer"
        )
    check_joint_units((name, channel.unit) for name, channel in channels.items())
    return channels
