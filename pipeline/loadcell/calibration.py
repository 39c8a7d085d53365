"""Calibration of a load cell, which converts the converter's counts to newtons, and its file."""

import math
import os
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

from armdyn import atomic
from armdyn.errors import InputError
from pipeline.loadcell.faults import LoadCellFaultLimits
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS
from urdf.bounds import has_plausible_magnitude
from urdf.toml_tables import TomlFileError, TomlValueCheck, read_toml_with_text, table_to_dataclass

QUANTITY_UNITS = {"offset": "count", "scale": "N/count", "noise": "N"}
"""Unit of each quantity in a calibration's file."""


_Number = Annotated[float, TomlValueCheck(has_plausible_magnitude, "give a size that a load cell has")]


def _in_unit(name: str) -> TomlValueCheck:
    return TomlValueCheck(lambda quantity: quantity.unit == QUANTITY_UNITS[name], f"give it in {QUANTITY_UNITS[name]}")


@dataclass(frozen=True)
class _Noise:
    value: _Number
    unit: str


@dataclass(frozen=True)
class _Fitted(_Noise):
    std: _Number


@dataclass(frozen=True)
class _File:
    """Entries of a calibration's file."""

    date: datetime
    source: str
    offset: Annotated[_Fitted, _in_unit("offset")]
    scale: Annotated[_Fitted, _in_unit("scale")]
    noise: Annotated[_Noise, _in_unit("noise")]


@dataclass(frozen=True)
class Calibration:
    """Calibration of a load cell: force = scale (counts - offset).

    Attributes:
        offset: counts of the cell without a load [counts].
        offset_std: standard deviation of the offset [counts].
        scale: force per count [N/count]; negative if a pull lowers the counts.
        scale_std: standard deviation of the scale [N/count].
        noise: standard deviation of one sample [N].
        date: date and time of the calibration.
        source: how the calibration was made.
    """

    offset: float
    offset_std: float
    scale: float
    scale_std: float
    noise: float
    date: datetime
    source: str

    def __post_init__(self) -> None:
        if not MINIMUM_COUNTS <= self.offset <= MAXIMUM_COUNTS:
            raise InputError(f"offset {self.offset:g} is beyond the 24 bits of the HX711")
        if self.scale == 0.0 or not math.isfinite(self.scale):
            raise InputError("scale is zero or infinite")
        if not (self.offset_std >= 0.0 and self.scale_std >= 0.0 and self.noise > 0.0):
            raise InputError("a standard deviation is negative, or the noise is zero")

    @property
    def force_limits(self) -> LoadCellFaultLimits:
        """Limits for detecting faults in this cell's samples of force [N]."""
        ends = sorted((self.force(MINIMUM_COUNTS), self.force(MAXIMUM_COUNTS)))
        return LoadCellFaultLimits.from_noise(self.noise, abs(self.scale), *ends)

    def force(self, counts: float) -> float:
        """Convert counts to a force [N]."""
        return self.scale * (counts - self.offset)

    def counts(self, force: float) -> float:
        """Convert a force [N] to counts."""
        return self.offset + force / self.scale

    def quantities(self) -> dict[str, dict[str, float | str]]:
        """Offset, scale and noise as dictionaries with value, unit and, except for the noise, standard deviation."""
        stds = {"offset": {"std": self.offset_std}, "scale": {"std": self.scale_std}}
        return {
            name: {"value": getattr(self, name), **stds.get(name, {}), "unit": unit}
            for name, unit in QUANTITY_UNITS.items()
        }

    def save(self, path: Path) -> None:
        """Write the calibration to a file; an interrupted write leaves the old file unchanged.

        Raises:
            InputError: the file cannot be written.
        """
        import tomlkit

        document = tomlkit.document()
        document.add(tomlkit.comment("load cell with HX711: force = scale (counts - offset)"))
        document.add("date", tomlkit.item(self.date))
        document.add("source", tomlkit.item(self.source))
        for name, entries in self.quantities().items():
            table = tomlkit.inline_table()
            table.update(entries)
            document.add(name, table)
        atomic.make_directory(path.parent)
        atomic.write_text(path, tomlkit.dumps(document))

    @classmethod
    def load(cls, path: Path) -> "Calibration":
        """Read a calibration that `save` wrote.

        Raises:
            InputError: the file is missing or cannot be used; the message advises to calibrate again.
        """
        remedy = "run 'armdyn loadcell calibrate PORT'"
        try:
            file = table_to_dataclass(_File, read_toml_with_text(path, finite=True)[1])
            offset, scale, noise = file.offset, file.scale, file.noise
            return cls(offset.value, offset.std, scale.value, scale.std, noise.value, file.date, file.source)
        except FileNotFoundError as error:
            raise InputError(f"{path}: there is no load cell calibration: {remedy}") from error
        except (TomlFileError, InputError) as error:
            raise InputError(f"{path}: the load cell calibration cannot be used, {error}: {remedy}") from error


def default_calibration_path() -> Path:
    """Default path of the calibration's file: ``armdyn/loadcell.toml`` in the user's settings directory."""
    settings = os.environ.get("XDG_CONFIG_HOME")
    return (Path(settings) if settings else Path.home() / ".config") / "armdyn" / "loadcell.toml"
