"""The rows as one Parquet file: a column per quantity, its unit in its name."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from armdyn import atomic
from armdyn.errors import InputError
from pipeline.batch.run import Row
from pipeline.batch.spec import Spec

NAME = "batch.parquet"


def check_parquet() -> None:
    """Refuse early where nothing can write the file.

    Raises:
        InputError: pyarrow is missing.
    """
    if find_spec("pyarrow") is None:
        raise InputError("a batch needs pyarrow: run 'pip install armdyn[batch]'")


def write_parquet(path: Path, spec: Spec, rows: Sequence[Row]) -> None:
    """Write the rows in one step.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fixed = {
        "robot": pa.string(), "model": pa.string(), "recording": pa.string(), "time": pa.timestamp("us", tz="UTC"),
        "time_from": pa.string(), "verdict": pa.string(), "problem": pa.string(), "sentence": pa.string(),
        "explained": pa.float64(), "effects": pa.list_(pa.string()), "chi2_per_sample": pa.float64(),
        "intervals_hold": pa.bool_(), "duration [s]": pa.float64(), "seconds": pa.float64(),
    }  # fmt: skip
    cells = [_cells(spec, row) for row in rows]
    numbers = sorted({name for cell in cells for name in cell if name not in fixed}, key=_order)
    columns = {name: pa.array([cell.get(name) for cell in cells], kind) for name, kind in fixed.items()}
    columns |= {name: pa.array([cell.get(name) for cell in cells], pa.float64()) for name in numbers}
    with atomic.replacing(path) as file:
        pq.write_table(pa.table(columns), file, compression="zstd")


def _cells(spec: Spec, row: Row) -> Mapping[str, Any]:
    item, outcome = row.item, row.outcome
    cells: dict[str, Any] = {
        "robot": item.robot,
        "model": spec.name(item.model),
        "recording": spec.name(item.run),
        "time": item.when.time,
        "time_from": item.when.source.key if item.when.time is not None else None,
        "verdict": outcome.verdict or None,
        "problem": outcome.problem or None,
        "sentence": outcome.sentence or None,
        "explained": outcome.explained,
        "effects": list(outcome.effects) if outcome.verdict else None,
        "chi2_per_sample": outcome.chi2_per_sample,
        "intervals_hold": outcome.intervals_hold if outcome.verdict else None,
        "duration [s]": outcome.duration,
        "seconds": outcome.seconds,
    }
    for name, channel in (outcome.channels or {}).items():
        cells[f"rmse.{name} [{channel['unit']}]"] = channel["rmse"]
        cells[f"noise.{name} [{channel['unit']}]"] = channel["noise_std"]
    for name, parameter in (outcome.parameters or {}).items():
        cells[f"value.{name} [{parameter['unit']}]"] = parameter["value"]
        cells[f"std.{name} [{parameter['unit']}]"] = parameter["std"]
    return cells


def _order(name: str) -> tuple[int, str, str]:
    """Errors first; a standard deviation beside its value."""
    kind, _, rest = name.partition(".")
    return (0 if kind in ("rmse", "noise") else 1, rest, "" if kind in ("rmse", "value") else kind)
