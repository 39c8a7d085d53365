"""Outcomes on disk, a line each, written as they come: whatever ends a batch, what was finished is kept.

The file is only ever added to, by one process at a time. A last line that was cut off by a crash is cut away; of two
outcomes of one job the later counts.
"""

import dataclasses
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from armdyn.errors import InputError
from pipeline.batch.work import Outcome

NAME = "outcomes.jsonl"


class Journal:
    """The outcomes of one folder; use `opened`.

    Attributes:
        outcomes: by key of their job.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.outcomes: dict[str, Outcome] = {}
        whole = self._read()
        self._file = path.open("ab")
        self._file.truncate(whole)

    def _read(self) -> int:
        """Read what is there; the number of bytes that are whole lines."""
        if not self._path.exists():
            return 0
        data = self._path.read_bytes()
        whole = data.rfind(b"\n") + 1
        known = {field.name for field in dataclasses.fields(Outcome)}
        for line in data[:whole].splitlines():
            try:
                fields = json.loads(line)
                fields["effects"] = tuple(fields["effects"])
                outcome = Outcome(**{key: value for key, value in fields.items() if key in known})
            except (ValueError, TypeError, KeyError):  # a disk's mistake, or another version's: the job is done again
                continue
            self.outcomes[outcome.key] = outcome
        return whole

    def add(self, outcome: Outcome) -> None:
        """Keep an outcome.

        Raises:
            InputError: the disk is full.
        """
        line = json.dumps(dataclasses.asdict(outcome), allow_nan=False) + "\n"
        try:
            self._file.write(line.encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(
                f"cannot write {self._path}: {error.strerror or error}; make room and run it again"
            ) from error
        self.outcomes[outcome.key] = outcome

    def close(self) -> None:
        """Nothing more comes."""
        self._file.close()


@contextmanager
def opened(folder: Path) -> Iterator[Journal]:
    """The journal of a folder that this process alone writes to.

    Raises:
        InputError: the folder cannot be written to.
    """
    try:
        journal = Journal(folder / NAME)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}; choose another --output") from error
    try:
        yield journal
    finally:
        journal.close()
