"""Side-by-side timing for the benchmarks.

The machine's speed drifts with what else runs on it, so the contenders take turns (A B A B ...) in one process run and
are compared round by round. Ratios are what is claimed; milliseconds are printed for orientation only.
"""

import argparse
import gc
import importlib.metadata
import json
import multiprocessing
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from armdyn.threads import one_thread

Contender = Callable[[], float]
"""Function that does the work once and returns its duration [s]."""
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Default folder of the public recordings, which are not in the repository."""
PACKAGES = ("armdyn", "casadi", "crocoddyl", "numpy", "scipy")


@dataclass(frozen=True)
class Ratio:
    """Ratio of the durations of two contenders over the rounds.

    Attributes:
        median: of the ratios within each round.
        low: tenth percentile.
        high: ninetieth percentile.
    """

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.median:.2f} ({self.low:.2f}..{self.high:.2f})"


@dataclass(frozen=True)
class Claim:
    """A statement that the benchmark checks.

    Attributes:
        sentence: what is claimed.
        measured: what came out.
        met: whether it holds; None where this run was too short to say.
    """

    sentence: str
    measured: str
    met: bool | None


def timed(work: Callable[[], object]) -> Contender:
    """Contender that measures the duration of `work`."""

    def run() -> float:
        started = perf_counter()
        work()
        return perf_counter() - started

    return run


@one_thread  # the rivals as well: methods are compared
def race(contenders: Mapping[str, Contender], rounds: int) -> dict[str, np.ndarray]:
    """Durations of contenders in turns; every second round runs backwards, so that none always follows the same other.

    Returns:
        (rounds,) s for each; one round that warms caches up is not counted.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for run in contenders.values():
        run()
    gc.collect()
    gc.disable()
    try:
        for turn in range(rounds):
            for name in list(contenders)[:: -1 if turn % 2 else 1]:
                seconds[name].append(contenders[name]())
    finally:
        gc.enable()
    return {name: np.array(values) for name, values in seconds.items()}


def ratio(seconds: Mapping[str, np.ndarray], name: str, base: str) -> Ratio:
    """Time of `name` over the time of `base`, round by round."""
    low, median, high = np.quantile(seconds[name] / seconds[base], [0.1, 0.5, 0.9])
    return Ratio(float(median), float(low), float(high))


def milliseconds(seconds: np.ndarray) -> str:
    """Median of durations, as text in milliseconds."""
    return f"{1e3 * np.median(seconds):.3g}"


@contextmanager
def without_compiler() -> Iterator[Callable[[Contender], Contender]]:
    """Wrapper that runs contenders, functions of a module, in a process where armdyn has no C compiler."""
    os.environ["ARMDYN_COMPILE"] = "0"
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        pool.submit(os.getpid).result()  # the process starts now, with the variable set
        del os.environ["ARMDYN_COMPILE"]
        yield lambda contender: lambda: pool.submit(contender).result()


def arguments(description: str, rounds: int, quick_rounds: int) -> argparse.ArgumentParser:
    """Parser with the options that all benchmarks share; `rounds` is None unless given."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--rounds", type=int, help=f"turns of each contender ({rounds}; {quick_rounds} with --quick)")
    parser.add_argument("--quick", action="store_true", help="a few seconds only: checks answers, judges no ratio")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    parser.set_defaults(default_rounds=(quick_rounds, rounds))
    return parser


def rounds_of(options: argparse.Namespace) -> int:
    """Number of rounds to run."""
    quick, full = options.default_rounds
    return options.rounds or (quick if options.quick else full)


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], texts: int = 1) -> None:
    """Print a table whose first `texts` columns are text and whose others are numbers."""
    widths = [max(len(row[i]) for row in (headings, *rows)) for i in range(len(headings))]
    print(f"\n{title}")
    for row in (headings, ["-" * width for width in widths], *rows):
        cells = (
            cell.ljust(width) if i < texts else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        print("  ".join(cells).rstrip())


def conclude(claims: Sequence[Claim], results: Mapping[str, Any], path: Path | None) -> int:
    """Print the claims, write everything as JSON where wanted; 1 when a claim is missed, else 0."""
    verdicts = {True: "met", False: "MISSED", None: "not judged"}
    print()
    for claim in claims:
        print(f"[{verdicts[claim.met]}] {claim.sentence}: {claim.measured}")
    if path is not None:
        machine = {
            "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
            "python": platform.python_version(),
            "machine": platform.machine(),
            "cores": os.cpu_count(),
            "packages": {name: version for name in PACKAGES if (version := _version(name)) is not None},
        }
        stated = [{"claim": c.sentence, "measured": c.measured, "met": c.met} for c in claims]
        path.write_text(json.dumps({"machine": machine, "claims": stated, **results}, indent=1, default=_plain) + "\n")
    return int(any(claim.met is False for claim in claims))


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Ratio):
        return {"median": value.median, "low": value.low, "high": value.high}
    raise TypeError(f"{type(value).__name__} has no place in the JSON")
