"""Sentences that are said of bad input, as kept in `golden/messages.json` under the test that brings them about.

`GOLDEN=write pytest ...` writes those that differ; read the difference before you keep it. Numbers may differ as far as
processors round otherwise; places of the test's own files are left out.
"""

import fcntl
import json
import math
import os
import re
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

FILE = Path(__file__).parent / "golden" / "messages.json"
WRITE = os.environ.get("GOLDEN") == "write"
DIGITS = 1e-3  # relative, by which a number may differ
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def kept():
    """Sentences by test."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


def write(key, sentence):
    """Keep a sentence, whichever processes do so at the same time."""
    with FILE.open("r+" if FILE.is_file() else "w+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        known = json.loads(file.read() or "{}")
        file.seek(0)
        file.truncate()
        json.dump(known | {key: sentence}, file, indent=0, sort_keys=True, ensure_ascii=False)
        file.write("\n")


def alike(found, known):
    """Whether two sentences have the same words and nearly the same numbers."""
    if NUMBER.sub("#", found) != NUMBER.sub("#", known):
        return False
    pairs = zip(map(float, NUMBER.findall(found)), map(float, NUMBER.findall(known)), strict=True)
    return all(math.isclose(a, b, rel_tol=DIGITS, abs_tol=1e-12) for a, b in pairs)


class Sentences:
    """What one test is told, in the order in which it is told.

    Args:
        test: its name in the file.
        folder: above its own files.
    """

    def __init__(self, test, folder):
        self._test, self._folder, self._count, self._last = test, folder, 0, None

    @contextmanager
    def __call__(self, kind):
        """As `pytest.raises`; the error's sentence is the one that is kept."""
        with pytest.raises(kind) as error:
            yield error
        self.line(str(error.value))

    def line(self, text):
        """The text is one line, the one that is kept; what is told twice in succession is kept once."""
        found = text.strip()
        for folder in (self._folder, Path(tempfile.gettempdir())):
            found = re.sub(rf"{re.escape(str(folder))}/[^\s/:,;'\"]*", "HERE", found)
        found = re.sub(r"\S+\.hpp:\d+", "SOURCE", found.replace(str(FILE.parents[2]), "REPOSITORY"))
        found = re.sub(r"(?<=127\.0\.0\.1:)\d+", "PORT", found)
        assert "\n" not in found
        if self._last is not None and alike(found, self._last):
            return
        self._last, self._count = found, self._count + 1
        key = self._test + (f" ({self._count})" if self._count > 1 else "")
        known = kept()
        if WRITE and not alike(found, known.get(key, "")):
            write(key, found)
        else:
            assert key in known, f"not kept yet: {found}"
            assert alike(found, known[key]), f"{found}\nwas kept as\n{known[key]}"
