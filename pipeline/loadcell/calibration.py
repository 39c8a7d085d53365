"""From counts to newtons: the stored calibration of one load cell, and the measured weights that it is made with."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TypeGuard

from armdyn.atomic import write_text
from armdyn.errors import InputError
from armdyn.units import parse_quantity
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS
from urdf.bounds import is_sane
from urdf.table_file import TableFileError, read_table


@dataclass(frozen=True)
class Calibration:
    """force = scale (counts - offset).

    Attributes:
        offset: counts of the empty cell, with what always hangs on it.
        offset_std: its standard deviation [counts].
        scale: [N/count]; negative where a pull lowers the counts.
        scale_std: its standard deviation [N/count].
        noise: standard deviation of one sample [N].
        date: when it was made.
        source: how it was made.
    """

    offset: float
    offset_std: float
    scale: float
    scale_std: float
    noise: float
    date: datetime
    source: str

    def __post_init__(self) -> None:
        numbers = (self.offset, self.offset_std, self.scale, self.scale_std, self.noise)
        if not all(math.isfinite(number) for number in numbers):
            raise InputError("a number is not finite")
        if not MINIMUM_COUNTS <= self.offset <= MAXIMUM_COUNTS:
            raise InputError(f"offset {self.offset:g} is beyond the 24 bits of the HX711")
        if self.scale == 0.0:
            raise InputError("scale is zero")
        if min(self.offset_std, self.scale_std) < 0.0 or self.noise <= 0.0:
            raise InputError("a standard deviation is negative, or the noise is zero")

    @property
    def count_noise(self) -> float:
        """Standard deviation of one sample [counts]."""
        return self.noise / abs(self.scale)

    def force(self, counts: float) -> float:
        """Force [N] at these counts."""
        return self.scale * (counts - self.offset)

    def counts(self, force: float) -> float:
        """Counts at this force [N]."""
        return self.offset + force / self.scale

    def save(self, path: Path) -> None:
        """Write it to `path`, which is the old file or the whole new one at every moment.

        Raises:
            InputError: `path` cannot be written to.
        """
        import tomlkit

        document = tomlkit.document()
        document.add(tomlkit.comment("load cell with HX711: force = scale (counts - offset)"))
        document.add("date", tomlkit.item(self.date))
        document.add("source", tomlkit.item(self.source))
        document.add("offset", _inline(value=self.offset, std=self.offset_std, unit="count"))
        document.add("scale", _inline(value=self.scale, std=self.scale_std, unit="N/count"))
        document.add("noise", _inline(value=self.noise, unit="N"))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make the folder {path.parent}: {error.strerror}; choose another place") from error
        write_text(path, tomlkit.dumps(document))

    @classmethod
    def load(cls, path: Path) -> "Calibration":
        """Read what `save` wrote.

        Raises:
            InputError: it is missing or cannot be used; says to calibrate again.
        """
        remedy = "run 'armdyn loadcell calibrate PORT'"
        try:
            return cls._from_table(read_table(path, finite=True)[1])
        except FileNotFoundError as error:
            raise InputError(f"{path}: there is no load cell calibration: {remedy}") from error
        except TableFileError as error:
            raise InputError(f"{path}: the load cell calibration {error}: {remedy}") from error
        except InputError as error:
            raise InputError(f"{path}: the load cell calibration cannot be used, {error}: {remedy}") from error

    @classmethod
    def _from_table(cls, table: Mapping[str, object]) -> "Calibration":
        date, source = table.get("date"), table.get("source")
        if not isinstance(date, datetime):
            raise InputError("date is missing or is no date with time")
        if not isinstance(source, str):
            raise InputError("source is missing or is no text")
        offset, offset_std = _number(table, "offset", "count")
        scale, scale_std = _number(table, "scale", "N/count")
        noise, _ = _number(table, "noise", "N", with_std=False)
        return cls(offset, offset_std, scale, scale_std, noise, date, source)


def default_path() -> Path:
    """Where the calibration is kept by default: ``loadcell.toml`` among the user's settings."""
    settings = os.environ.get("XDG_CONFIG_HOME")
    return (Path(settings) if settings else Path.home() / ".config") / "armdyn" / "loadcell.toml"


def _inline(**entries: float | str) -> object:
    import tomlkit

    table = tomlkit.inline_table()
    table.update(entries)
    return table


def _number(table: Mapping[str, object], key: str, unit: str, with_std: bool = True) -> tuple[float, float]:
    entry = table.get(key)
    if not isinstance(entry, dict):
        raise InputError(f"{key} is missing or is no table")
    if entry.get("unit") != unit:
        raise InputError(f"{key} is not in {unit}")
    value, std = entry.get("value"), entry.get("std") if with_std else 0.0
    if not (_is_number(value) and _is_number(std)):
        raise InputError(f"{key} lacks a number")
    if not (is_sane(value) and is_sane(std)):
        raise InputError(f"{key} is {value:g}, of no size that a load cell has")
    return float(value), float(std)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)  # in Python, True is an int


@dataclass(frozen=True)
class Weight:
    """A known weight.

    Attributes:
        text: as the user wrote it.
        force: what it pulls with [N].
        force_std: its standard deviation [N], 0 where none was given.
    """

    text: str
    force: float
    force_std: float = 0.0


def parse_weights(text: str, gravity: float) -> tuple[Weight, ...]:
    """Read ``"0 g, 100 g, 200 g +/- 0.1 g"``; forces such as ``"1 N"`` are taken too.

    The empty cell comes first, whether it was listed or not.

    Args:
        text: separated by commas.
        gravity: free-fall acceleration [m/s^2].

    Raises:
        InputError: not a mass or a force, negative, or fewer than two different ones.
    """
    weights = [_parse(part.strip(), gravity) for part in text.split(",") if part.strip()]
    if not weights or weights[0].force > 0.0:
        weights.insert(0, Weight("0 g", 0.0))
    if len({weight.force for weight in weights}) < 2:
        raise InputError(f"--weights '{text}': give at least one weight besides the empty cell, such as '0 g, 200 g'")
    return tuple(weights)


def _parse(text: str, gravity: float) -> Weight:
    for unit, pull in (("kg", gravity), ("N", 1.0)):
        try:
            known = parse_quantity(text, unit)
        except InputError:
            continue
        if known.value < 0.0:
            raise InputError(f"--weights: '{text}' is negative: hang it so that it pulls the way the load will")
        return Weight(text, pull * known.value, pull * (known.std or 0.0))
    raise InputError(f"--weights: '{text}' is neither a mass nor a force: write '100 g', '100 g +/- 0.1 g' or '1 N'")
