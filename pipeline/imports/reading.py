"""Reads whatever a person gives: a table, a bag, a data set."""

from pathlib import Path

from armdyn.errors import InputError
from pipeline.imports.foreign import Foreign

BAGS = (".bag", ".mcap", ".db3")


def read_foreign(path: Path) -> list[Foreign]:
    """The recordings in a file or directory; most hold one.

    Raises:
        InputError: it is of no kind that can be read, or cannot be read.
    """
    if path.is_dir():
        from pipeline.imports.lerobot import is_lerobot, read_lerobot

        if is_lerobot(path):
            return read_lerobot(path)
        if (path / "metadata.yaml").is_file():
            from pipeline.imports.bag import read_bag

            return [read_bag(path)]
        raise InputError(
            f"{path}: is a directory, and neither a ROS 2 bag (metadata.yaml) nor a LeRobot data set "
            "(meta/info.json): give a recording"
        )
    suffix = path.suffix.lower()
    if suffix in BAGS:
        from pipeline.imports.bag import read_bag

        return [read_bag(path)]
    if suffix in (".parquet", ".pq"):
        from pipeline.imports.table import read_parquet

        return [read_parquet(path)]
    if suffix in (".csv", ".tsv", ".txt", ".dat"):
        from pipeline.imports.table import read_csv_of_any_dialect

        return [read_csv_of_any_dialect(path)]
    raise InputError(
        f"{path}: '{suffix}' is of no kind that can be read: give .csv, .tsv, .txt, .parquet, .bag, .mcap, .db3, the "
        "directory of a ROS 2 bag or of a LeRobot data set"
    )
