"""Spoiled files of every kind end in an answer or in one line: no traceback, no hang, no gigabytes.

A file that is read badly is kept outside the sources, and the failure says where: hypothesis makes it as small as it
can. Copy it to ``corpus/<kind>/`` when the mistake is mended; every later run reads it again and spoils it further.
"""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from faults import doors
from hypothesis import HealthCheck, given, settings

pytest.importorskip("pyarrow", reason="needs the extra 'import'")
FINE = ("read", "refused")
EXAMPLES = int(os.environ.get("ARMDYN_BAD_FILES", "20"))  # of each kind; a campaign is ARMDYN_BAD_FILES=200
NAMES = sorted(doors.doors())
campaign = settings(
    max_examples=EXAMPLES, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
)  # fmt: skip


def check(door, data, folder, read=None):
    verdict, said = doors.tried(door, data, Path(folder), read)
    if verdict not in FINE:
        place = Path(tempfile.gettempdir(), "armdyn-badly-read", door.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    assert verdict in FINE, f"kept as {place}: {verdict}: {said}"
    return verdict


@pytest.mark.parametrize("name", NAMES)
def test_good_files_of_every_kind_are_read(tmp_path, name):
    door = doors.doors()[name]
    for good in door.seeds:
        assert doors.tried(door, good, tmp_path, door.deep) == ("read", "")


@pytest.mark.parametrize("name", NAMES)
def test_files_that_were_once_read_badly_are_read_or_refused(tmp_path, name):
    door = doors.doors()[name]
    for data in doors.kept(name):
        check(door, data, tmp_path, door.deep)


@pytest.mark.parametrize("name", NAMES)
def test_spoiled_files_are_read_or_refused_in_one_line(name):
    door, verdicts = doors.doors()[name], []

    @campaign
    @given(door.spoiled)
    def campaign_of(data):
        with tempfile.TemporaryDirectory() as folder:
            verdicts.append(check(door, data, folder))

    campaign_of()
    if name != "outcomes.jsonl":  # a line that cannot be read is a job that is done again
        assert "refused" in verdicts  # most mistakes are noticed


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if doors.doors()[name].deep is not None])
def test_spoiled_files_are_computed_with_or_refused(name):
    door = doors.doors()[name]

    @campaign
    @given(door.spoiled)
    def campaign_of(data):
        with tempfile.TemporaryDirectory() as folder:
            check(door, data, folder, door.deep)

    campaign_of()


def test_a_bad_reading_is_noticed(tmp_path, monkeypatch):
    """The campaign itself: whatever may go wrong has a verdict of its own."""
    door = doors.doors()["path.toml"]

    def fails(_):
        raise KeyError("x")

    def prints(_):
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

    monkeypatch.setattr(doors, "LONGEST", 0.2)
    every = (fails, prints, hangs, takes, two_lines, nameless)
    verdicts = [doors.tried(door, b"", tmp_path, read)[0] for read in every]
    expected = ["traceback: KeyError", "prints", "hang", "traceback: MemoryError", "not one line", "file not named"]
    assert verdicts == expected
