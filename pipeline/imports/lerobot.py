"""LeRobot data sets: Parquet files beside ``meta/info.json``, one run per episode."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from pipeline.imports.foreign import Column, Foreign
from pipeline.imports.table import parquet_columns

INFO = Path("meta/info.json")
_INDEX = re.compile(r"(?P<feature>.+)/(?P<index>\d+)")


def is_lerobot(path: Path) -> bool:
    """Whether a directory is a data set of LeRobot."""
    return (path / INFO).is_file()


def read_lerobot(path: Path) -> list[Foreign]:
    """Every episode of a data set of version 2 (a file per episode) or 3 (many episodes in a file).

    Entries of a feature get the names that ``info.json`` gives them: ``observation.state/elbow_flex.pos``.

    Raises:
        InputError: the description or a file cannot be read, or there is no episode.
    """
    info = _info(path)
    names = {feature: _names(about) for feature, about in info.get("features", {}).items()}
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{path}: holds no Parquet file under data/: download the data set's data too")
    rate = info.get("fps")
    found = []
    for file in files:
        columns, notes = parquet_columns(file)
        named = {_named(label, names): column for label, column in columns.items()}
        if "timestamp" not in named and isinstance(rate, int | float) and rate > 0 and "frame_index" in named:
            named["timestamp"] = Column(named["frame_index"].value / rate, "s")
        episodes = named["episode_index"].value if "episode_index" in named else None
        for episode in [None] if episodes is None else np.unique(episodes):
            rows = slice(None) if episode is None else episodes == episode
            of_episode = {
                label: Column(column.value[rows], "s" if label == "timestamp" else column.unit)
                for label, column in named.items()
                if label.rpartition("_")[2] != "index"
            }
            name = file.stem if episode is None else f"{path.name}_episode_{int(episode):06d}"
            found.append(Foreign(name, of_episode, notes))
    return found


def _info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads((path / INFO).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path / INFO}: cannot be read as JSON: {error}") from error
    if not isinstance(info, dict):
        raise InputError(f"{path / INFO}: does not hold an object: give a LeRobot data set")
    return info


def _names(about: Any) -> list[str]:
    """Names of a feature's entries: a list, or a list under one key such as ``motors``."""
    names = about.get("names") if isinstance(about, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _named(label: str, names: dict[str, list[str]]) -> str:
    match = _INDEX.fullmatch(label)
    if match is None or match["feature"] not in names:
        return label
    known, index = names[match["feature"]], int(match["index"])
    return f"{match['feature']}/{known[index]}" if index < len(known) else label
