"""Spoiled files of every kind end in an answer or in one line: no traceback, no hang, no gigabytes."""

from collections import Counter
from contextlib import suppress

import pytest
from faults import fuzzing

FINE = ("read", "refused")
QUICK, SLOW = range(360), range(360, 6000)
GROUP = 60
"""Files of one test."""


def campaign(seeds, folder, whole=False):
    """Try the files of these seeds; what is read badly goes into the corpus."""
    counts, bad = Counter(), []
    for seed in seeds:
        door, data = fuzzing.spoiled(seed)
        verdict, said = fuzzing.tried(door, data, folder, fuzzing.deep(door) if whole else None)
        counts[verdict] += 1
        if verdict not in FINE:
            bad.append(f"seed {seed}, kept as {fuzzing.keep(door, data)}: {verdict}: {said}")
    assert not bad, "\n\n".join(bad)
    return counts


@pytest.mark.parametrize("name", fuzzing.WEIGHTS)
def test_good_files_of_every_kind_are_read(tmp_path, name):
    door = fuzzing.doors()[name]
    for good in door.seeds:
        assert fuzzing.tried(door, good, tmp_path, fuzzing.deep(door)) == ("read", "")


@pytest.mark.parametrize("name", fuzzing.WEIGHTS)
def test_files_that_were_once_read_badly_are_read_or_refused(tmp_path, name):
    door = fuzzing.doors()[name]
    for data in fuzzing.kept(name):
        verdict, said = fuzzing.tried(door, data, tmp_path, fuzzing.deep(door))
        assert verdict in FINE, said


@pytest.mark.parametrize("first", QUICK[::GROUP])
def test_spoiled_files_are_read_or_refused_in_one_line(tmp_path, first):
    counts = campaign(range(first, first + GROUP), tmp_path)
    assert counts["refused"] > GROUP / 2  # most mistakes are noticed


@pytest.mark.slow
@pytest.mark.parametrize("first", SLOW[::GROUP])
def test_thousands_of_spoiled_files_are_read_refused_or_computed_with(tmp_path, first):
    campaign(range(first, first + GROUP), tmp_path, whole=True)


def test_a_bad_reading_is_noticed(tmp_path):
    """The campaign itself: whatever may go wrong has a verdict of its own."""
    door = fuzzing.doors()["path.toml"]

    def fails(_):
        raise KeyError("x")

    def prints(_):
        import os

        os.write(2, b"Error: at line 508")

    def hangs(_):
        while True:
            with suppress(Exception):  # as a reader that takes every error for a bad file would
                while True:
                    pass

    def takes(_):
        return len(bytearray(10**15))

    def two_lines(_):
        from armdyn.errors import InputError

        raise InputError("path.toml:\nwrong")

    def nameless(_):
        from armdyn.errors import InputError

        raise InputError("wrong")

    fuzzing_limit, fuzzing.LONGEST = fuzzing.LONGEST, 0.2
    try:
        verdicts = [
            fuzzing.tried(door, b"", tmp_path, read)[0] for read in (fails, prints, hangs, takes, two_lines, nameless)
        ]
    finally:
        fuzzing.LONGEST = fuzzing_limit
    expected = ["traceback: KeyError", "prints", "hang", "traceback: MemoryError", "not one line", "file not named"]
    assert verdicts == expected
