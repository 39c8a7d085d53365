"""Does a command end promptly and in order, whenever Ctrl-C, SIGTERM, SIGHUP or kill -9 comes?

    python benchmarks/interrupts.py [--tries N] [--signals INT,TERM,HUP,KILL] [--command "trial ..."] [--json FILE]

Each try starts `armdyn` in a directory of its own and sends one signal at a random instant, from the first import of
armdyn on. What counts: the exit status, no traceback, the time to the end, and that the recording in its folder is the
old one with the old report, or a new one that can be read and has no old report beside it.
"""

import _timing as bench  # isort: skip

import argparse
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from armdyn.errors import ArmdynError
from armdyn.run import read_run

START = "import sys; import pipeline; sys.stderr.write('armdyn\\n'); from pipeline.cli import main; main()"
"""Program that prints a word when Python is ready and armdyn's first import begins."""
LONGEST = 120.0
BEFORE, OLD = ("trial.mcap", "trial.csv", "model.toml", "report.html"), "of the last trial"
"""Files that exist before the command, and their content."""


@dataclass(frozen=True)
class Try:
    """Result of one signal: its time, the process's exit status and delay, and the errors, empty if there are none."""

    name: str
    at: float
    status: int
    seconds: float
    wrong: str


def attempt(name: str, at: float, command: list[str]) -> Try:
    """Start a command, send it a signal, wait for its end and check its files."""
    number = getattr(signal, f"SIG{name}")
    with TemporaryDirectory() as scratch:
        (Path(scratch) / "out").mkdir()
        for file in BEFORE:
            (Path(scratch) / "out" / file).write_text(OLD)
        process = subprocess.Popen(
            [sys.executable, "-c", START, *command], cwd=scratch, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        assert process.stderr is not None
        process.stderr.readline()
        time.sleep(at)
        process.send_signal(number)
        sent = time.monotonic()
        try:
            said = process.communicate(timeout=LONGEST)[1].decode(errors="replace")
            seconds = time.monotonic() - sent
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return Try(name, at, 0, LONGEST, "did not end")
        wanted = {-signal.SIGKILL} if name == "KILL" else {128 + number, -number}  # a shell shows both as the first
        wrong = [f"status {process.returncode}"] if process.returncode not in {*wanted, *over(seconds)} else []
        wrong += ["traceback"] if "Traceback" in said else []
        wrong += damage(Path(scratch), killed=name == "KILL")
        return Try(name, at, process.returncode, seconds, ", ".join(wrong))


def over(seconds: float) -> set[int]:
    """Exit statuses of a command that had ended when the signal came."""
    return {0, 1} if seconds < 1.0 else set()


def damage(folder: Path, killed: bool) -> list[str]:
    """Faults in the files of a command: unreadable, left over, or an old report beside new files."""
    found, out = [], folder / "out"
    old = {name for name in BEFORE if (out / name).exists() and (out / name).read_bytes() == OLD.encode()}
    if "report.html" in old and old != set(BEFORE):
        found.append(f"an old report beside new files: old are {sorted(old)}")
    if "trial.mcap" not in old:
        try:
            read_run(out / "trial.mcap")
        except (ArmdynError, OSError) as error:
            found.append(f"recording: {error}")
    if not killed:
        found += [f"left over: {path.name}" for path in folder.rglob(".armdyn-*") if path.is_file()]
    return found


def main() -> int:
    """Run the benchmark; 1 where a claim is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=100, help="of each signal")
    parser.add_argument("--signals", default="INT,TERM,HUP")
    parser.add_argument("--command", default="trial --out out", help="of armdyn")
    parser.add_argument("--until", type=float, default=8.0, help="latest instant of a signal [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    tries: list[Try] = []
    for k in range(options.tries):
        for name in options.signals.split(","):
            # Half of them in the first two seconds, where everything is imported.
            latest = options.until if k % 2 else min(2.0, options.until)
            tries.append(attempt(name, float(rng.uniform(0.0, latest)), shlex.split(options.command)))
            if tries[-1].wrong:
                print(f"  {tries[-1]}", file=sys.stderr, flush=True)
    rows = []
    for name in options.signals.split(","):
        mine = [t for t in tries if t.name == name]
        seconds = np.array([t.seconds for t in mine])
        wrong = sum(bool(t.wrong) for t in mine)
        rows.append([name, str(len(mine)), str(wrong), *(f"{x:.2f}" for x in np.percentile(seconds, [50, 95, 100]))])
    bench.print_table(
        f"armdyn {options.command}: time from signal to end [s]",
        ["signal", "tries", "wrong", "50 %", "95 %", "most"],
        rows,
    )
    wrong = sum(bool(t.wrong) for t in tries)
    claim = bench.Claim(
        "every process ends with its signal's status and leaves nothing broken", f"{wrong} wrong", not wrong
    )
    return bench.conclude([claim], {"tries": [asdict(t) for t in tries]}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
