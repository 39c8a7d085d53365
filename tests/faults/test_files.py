"""Files stay what their owner made of them, and are the old one or the whole new one."""

import errno
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.read_files import refuse_overwriting_inputs
from armdyn.run import Run, read_run, write_run_csv
from pipeline.console.outputs import check_outputs

TEXT = "new\n" * 1000


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("old", ["old", None], ids=["a file", "nothing yet"])
def test_links_stay_and_what_they_lead_to_is_replaced_or_made(tmp_path, old):
    (tmp_path / "there").mkdir()
    target, link, second = tmp_path / "there" / "m.toml", tmp_path / "link.toml", tmp_path / "second.toml"
    if old is not None:
        target.write_text(old)
    link.symlink_to(target)
    second.symlink_to("link.toml")
    atomic.write_text(second, TEXT)
    assert link.is_symlink()
    assert second.is_symlink()
    assert target.read_text() == TEXT
    assert names(target.parent) == ["m.toml"]


def test_links_in_a_circle_are_refused(tmp_path, complains):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with complains(InputError):
        atomic.write_text(tmp_path / "a", TEXT)
    assert names(tmp_path) == ["a", "b"]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o755])
def test_the_mode_of_a_file_is_kept(tmp_path, mode):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(mode)
    atomic.write_text(path, TEXT)
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_a_new_file_has_the_mode_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        atomic.write_text(tmp_path / "a.txt", TEXT)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_write_protected_file_is_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o400)
    with pytest.raises(InputError, match="write-protected"):
        atomic.write_text(path, TEXT)
    assert path.read_text() == "old"


def test_a_fifo_is_written_to_and_stays(tmp_path):
    fifo, read = tmp_path / "fifo", []
    os.mkfifo(fifo)
    reader = threading.Thread(target=lambda: read.append(fifo.read_text()))
    reader.start()
    atomic.write_text(fifo, TEXT)
    reader.join(5)
    assert read == [TEXT]
    assert stat.S_ISFIFO(fifo.stat().st_mode)
    assert names(tmp_path) == ["fifo"]


def test_a_link_to_a_device_and_the_device_stay(tmp_path):
    (tmp_path / "null").symlink_to("/dev/null")
    for path in (tmp_path / "null", Path("/dev/null")):
        atomic.write_text(path, TEXT)
        assert stat.S_ISCHR(path.stat().st_mode)
    check_outputs(Path("/dev/null"), Path("/dev/null"))


@pytest.mark.parametrize("place", ["pipe", "file"])
def test_standard_output_is_written_to_in_order(tmp_path, place):
    code = (
        "from pathlib import Path; from armdyn import atomic; print('before'); "
        "atomic.write_text(Path('/dev/stdout'), 'middle\\n'); print('after')"
    )
    if place == "pipe":
        shown = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    else:
        with (tmp_path / "out").open("w") as out:
            subprocess.run([sys.executable, "-c", code], check=True, stdout=out)
        shown = (tmp_path / "out").read_text()
    assert shown == "before\nmiddle\nafter\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
def test_a_full_device_is_one_line(complains):
    with complains(InputError):
        atomic.write_text(Path("/dev/full"), TEXT)


def test_a_file_size_limit_is_one_line_and_no_leftovers(tmp_path):
    code = (
        "import resource, signal, sys; from pathlib import Path; from armdyn import atomic\n"
        "from armdyn.errors import InputError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: atomic.write_text(Path(sys.argv[1]), 'x' * 10000)\n"
        "except InputError as error: print(error)"
    )
    path = tmp_path / "a.txt"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert "cannot write" in done.stdout
    assert names(tmp_path) == []


def test_an_interrupt_leaves_the_old_file_alone(tmp_path):
    (tmp_path / "a.txt").write_text("old")

    def interrupted():
        with atomic.replace_file(tmp_path / "a.txt") as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_many_writers_of_one_file_leave_one_whole_file(tmp_path):
    texts = [letter * 200_000 for letter in "abcdefgh"]
    writers = [threading.Thread(target=atomic.write_text, args=(tmp_path / "a.txt", text)) for text in texts]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert (tmp_path / "a.txt").read_text() in texts
    assert names(tmp_path) == ["a.txt"]


def test_what_a_killed_program_left_goes_with_a_later_write(tmp_path):
    left, young, foreign = (tmp_path / name for name in (".armdyn-7-ab.tmp", ".armdyn-8-cd.tmp", "notes.tmp"))
    for file in (left, young, foreign):
        file.write_text("half")
    for file in (left, foreign):
        os.utime(file, (0, 0))
    atomic.write_text(tmp_path / "model.toml", "whole")
    assert not left.exists()
    assert young.exists()
    assert foreign.exists()


def test_names_that_no_file_can_have_are_refused(tmp_path, complains):
    for name in ("x" * 300, "nul\0l", "absent/a.txt"):
        with complains(InputError):
            atomic.write_text(tmp_path / name, TEXT)
        with complains(InputError):
            check_outputs(tmp_path / name)


def test_a_longest_name_can_be_written(tmp_path):
    atomic.write_text(tmp_path / ("x" * 255), TEXT)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
@pytest.mark.parametrize("where", [">/dev/full", ">&-"])
def test_json_on_a_full_or_closed_standard_output_is_refused(where):
    code = (
        "from pathlib import Path; from armdyn.errors import InputError\n"
        "from pipeline.console.screen import write_json\n"
        "try: write_json({'a': 1}, Path('-'))\n"
        "except InputError: import os; os._exit(7)"
    )
    done = subprocess.run(["sh", "-c", f'"$0" -c "$1" {where}', sys.executable, code], check=False)
    assert done.returncode == 7


def test_a_reader_that_ends_early_is_no_error():
    code = (
        "from pathlib import Path; from pipeline.console.screen import write_json\n"
        "write_json({'a': list(range(200000))}, Path('-'))"
    )
    done = subprocess.run(
        ["bash", "-c", 'set -o pipefail; "$0" -c "$1" | head -c 10', sys.executable, code],
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("old", ["old", None], ids=["a file", "nothing yet"])
def test_what_grows_on_a_full_disk_ends_with_a_whole_line_and_never_raises(tmp_path, old):
    code = (
        "import resource, sys; from pathlib import Path; from armdyn.atomic import CrashSafeGrowingFile\n"
        "file = CrashSafeGrowingFile(Path(sys.argv[1])); resource.setrlimit(resource.RLIMIT_FSIZE, (1005, 1005))\n"
        "for _ in range(300): file.write('123456789\\n')\n"
        "file.finish(); print(file.failure)"
    )
    path = tmp_path / "a.csv"
    if old is not None:
        path.write_text(old)
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("a.csv could not be written any further: File too large")
    written = [file for file in tmp_path.iterdir() if file.read_text() != "old"]
    assert [file.read_text() for file in written] == [100 * "123456789\n"]
    assert (path.read_text() == "old") == (old is not None)


@pytest.mark.parametrize("growing", [True, False])
def test_a_file_that_is_read_while_another_is_written_under_its_name_stays(tmp_path, growing):
    path, link = tmp_path / "a.csv", tmp_path / "b.csv"
    path.write_text("old")
    os.link(path, link)

    def replaced():
        with atomic.replace_file(path) as new:
            new.write(b"new")
            link.read_text()

    with refuse_overwriting_inputs():
        if growing:
            file = atomic.CrashSafeGrowingFile(path)
            file.write("new")
            link.read_text()
            file.finish()
            assert "is an input, which was read" in file.failure
        else:
            with pytest.raises(InputError, match="is an input, which was read"):
                replaced()
    assert path.read_text() == "old"
    assert len(names(tmp_path)) == 2 + growing  # what was recorded is kept beside it


def test_a_file_is_moved_over_another_but_not_over_an_input(tmp_path):
    for name in ("new", "old", "read"):
        (tmp_path / name).write_text(name)
    (tmp_path / "old").chmod(0o600)
    with refuse_overwriting_inputs():
        (tmp_path / "read").read_text()
        with pytest.raises(InputError, match="is an input"):
            atomic.move_file(tmp_path / "new", tmp_path / "read")
        atomic.move_file(tmp_path / "new", tmp_path / "old")
    assert names(tmp_path) == ["old", "read"]
    assert (tmp_path / "old").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "old").stat().st_mode) == 0o600


def test_a_full_disk_never_leaves_half_a_pair(tmp_path, monkeypatch, complains):
    """Whichever of the writes the disk refuses: both files are as they were, and nothing is beside them."""
    run = Run.from_arrays(np.arange(20) / 50, {"load_force": np.linspace(0.7, 0.9, 20)}, description="new")
    usual = os.fsync
    for existing in (True, False):
        for refused in range(1, 5):
            folder = tmp_path / f"{existing}{refused}"
            folder.mkdir()
            if existing:
                (folder / "a.csv").write_text("old")
                (folder / "a.toml").write_text("old")
            left = [refused]

            def full(descriptor, left=left):
                left[0] -= 1
                if left[0] == 0:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                usual(descriptor)

            monkeypatch.setattr(os, "fsync", full)
            if refused <= 2:  # before either takes its place; what follows finds nothing left to write
                with complains(InputError):
                    write_run_csv(run, folder / "a.csv")
                assert names(folder) == ["a.csv", "a.toml"] * existing
                assert all(path.read_text() == "old" for path in folder.iterdir())
            monkeypatch.setattr(os, "fsync", usual)
            write_run_csv(run, folder / "a.csv")
            assert read_run(folder / "a.csv").description == "new"
