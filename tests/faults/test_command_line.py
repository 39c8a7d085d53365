"""The command line's last net: whatever is raised, whoever reads, whichever signal comes."""

import os
import re
import signal
import subprocess
import sys
import types
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline import interrupts
from pipeline.cli import main

ARMDYN = "from pipeline.cli import main; main()"


@pytest.fixture
def armdyn(monkeypatch, capsys, tmp_path):
    """A command `fail` of this process that does what it is given: exit status, standard output, standard error."""

    def run(work):
        module = types.ModuleType("pipeline.commands.failing")
        module.HELP_PANEL, module.failing = "A mistake", work
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr("pipeline.console.app.command_modules", lambda: {"failing": "failing"})
        monkeypatch.setattr(sys, "argv", ["armdyn", "failing"])
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        monkeypatch.setattr("tempfile.tempdir", None)
        before = {number: signal.getsignal(number) for number in interrupts.signal_numbers()}
        unraisable = sys.unraisablehook
        try:
            with pytest.raises(SystemExit) as stop:
                main()
        finally:
            sys.unraisablehook = unraisable
            for number, handler in before.items():
                signal.signal(number, handler)
        return stop.value.code, *capsys.readouterr()

    return run


def raises(error):
    def work():
        raise error

    return work


@pytest.mark.parametrize(
    "error",
    [ZeroDivisionError("division\nby zero"), MemoryError(), RecursionError(), OSError(5, "Input/output error"),
     AssertionError(), SystemExit(0), UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte")],
    ids=lambda error: type(error).__name__,
)  # fmt: skip
def test_what_was_never_foreseen_is_one_line_and_a_report(armdyn, tmp_path, error):
    status, out, err = armdyn(raises(error))
    assert status == 3
    assert out == ""
    assert len(err.splitlines()) == 1
    assert type(error).__name__ in err
    report = Path(re.search(r"please send (\S+)", err)[1])
    assert report.parent == tmp_path
    assert "Traceback" in report.read_text()
    assert "command: armdyn fail" in report.read_text()


def test_a_report_that_cannot_be_written_still_leaves_a_line(armdyn, monkeypatch):
    def full(*_arguments, **_named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pipeline.console.streams.tempfile.NamedTemporaryFile", full)
    status, _, err = armdyn(raises(ZeroDivisionError()))
    assert status == 3
    assert re.search(r"it came from .*test_command_line.py, line \d+$", err.strip())


@pytest.mark.parametrize("number", interrupts.signal_numbers())
def test_a_signal_is_a_line_and_its_status(armdyn, monkeypatch, number):
    monkeypatch.setattr(interrupts._thread, "start_new_thread", lambda *_: None)  # it would end this process
    if signal.getsignal(number) is signal.SIG_IGN:  # these tests were started by nohup
        signal.signal(number, signal.SIG_DFL)
    status, _, err = armdyn(lambda: os.kill(os.getpid(), number))
    assert status == 128 + number
    assert len(err.splitlines()) == 1


def test_an_interrupt_that_a_library_swallows_or_renames_still_ends_the_command(armdyn, monkeypatch):
    monkeypatch.setattr(interrupts._thread, "start_new_thread", lambda *_: None)

    def swallows():
        with suppress(BaseException):
            os.kill(os.getpid(), signal.SIGINT)

    def renames():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except BaseException as error:
            raise ImportError("cannot import") from error

    assert armdyn(swallows)[0] == 130
    assert armdyn(renames)[0] == 143


def process(code, *arguments, **named):
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, **named
    )


HANDLED = "import os, signal, time; from pipeline.interrupts import SignalHandler; SignalHandler().install()\n"
SWALLOWED = "try: os.kill(os.getpid(), signal.SIGTERM)\nexcept BaseException: pass\n"
IN_A_FINALIZER = """class Odd:
    def __del__(self): os.kill(os.getpid(), signal.SIGINT)
odd = Odd(); del odd
"""


@pytest.mark.parametrize(("code", "status"), [(SWALLOWED, 143), (IN_A_FINALIZER, 130)], ids=["swallowed", "finalizer"])
def test_a_signal_that_python_loses_ends_the_command_all_the_same_and_prints_nothing(code, status):
    done = process(f"{HANDLED}{code}time.sleep(60)", timeout=50)
    assert done.returncode == status
    assert done.stderr == ""


def test_nohup_is_respected():
    code = (
        "import os, signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from pipeline.interrupts import SignalHandler; SignalHandler().install()\n"
        "os.kill(os.getpid(), signal.SIGHUP); print('on')"
    )
    assert process(code).stdout == "on\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
@pytest.mark.parametrize(
    ("shell", "status", "lines"),
    [
        ('"$0" -c "$1" --help >/dev/full', 2, 1),
        ('"$0" -c "$1" --help >&-', 0, 0),
        ('"$0" -c "$1" nonsense 2>&-', 2, 0),
        ('"$0" -c "$1" nonsense 2>/dev/full', 2, 0),
        ('set -o pipefail; "$0" -c "$1" --help | head -c 1 >/dev/null', 0, 0),
        ('PYTHONIOENCODING=latin-1 "$0" -c "$1" effects >/dev/null', 0, 0),
    ],
)
def test_any_standard_output_gives_a_sensible_status_and_no_traceback(shell, status, lines):
    done = subprocess.run(["bash", "-c", shell, sys.executable, ARMDYN], capture_output=True, text=True, check=False)
    assert done.returncode == status
    assert len(done.stderr.splitlines()) == lines, done.stderr
