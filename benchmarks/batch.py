"""A lab's thousand logs: 20 arms, 50 recordings of each, two of which change on a day. Are both found, and no other?

Then the same recordings with one and with two worker processes: how much faster are two.

    python benchmarks/batch.py [--labs 1] [--robots 20] [--recordings 50]
"""

import _timing as bench  # isort: skip

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from worlds.lab import Change, Lab

from pipeline.batch.history import parameter_history, utc_datetime
from pipeline.batch.run import run_batch
from pipeline.batch.spec import BatchSpec, read_spec

SPEC = 'task = "compare"\n[[recordings]]\nmodel = "robots/{robot}/model.toml"\nruns = ["robots/{robot}/logs/*.csv"]\n'
TOOL, FRICTION = 7, 13
"""Numbers of the robots that change: a tool 0.1 kg heavier, and an elbow with a quarter more dry friction."""


SHARE = 100
"""Number of recordings for the comparison of one worker with two."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--labs", type=int, default=1, help="with other robots, days and noise")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--recordings", type=int, default=50)
    asked = parser.parse_args()
    changes = {
        TOOL % asked.robots: Change(asked.recordings // 2, tool=0.1),
        FRICTION % asked.robots: Change(asked.recordings // 3, dry_friction=1.25),
    }
    for seed in range(asked.labs):
        with tempfile.TemporaryDirectory() as folder:
            one_lab(Path(folder), Lab(asked.robots, asked.recordings, changes, seed=seed), throughput=seed == 0)


def one_lab(folder: Path, lab: Lab, throughput: bool) -> None:
    lab.write(folder / "robots")
    (folder / "spec.toml").write_text(SPEC)
    spec = read_spec(folder / "spec.toml")
    if throughput:
        ratio(folder, replace(spec, items=spec.items[:SHARE]))
    (folder / "out").mkdir()
    began = time.perf_counter()
    done = run_batch(spec, folder / "out")
    worked = time.perf_counter() - began
    began = time.perf_counter()
    found = parameter_history(spec, done.rows)
    looked = time.perf_counter() - began
    bad = sum(bool(row.outcome.problem) for row in done.rows)
    print(f"seed {lab.seed}: {len(done.rows)} recordings of {lab.robots} robots, {bad} not usable")
    days = {f"robot_{robot:02d}": lab.days(robot)[change.recording] for robot, change in lab.changes.items()}
    for robot, day in days.items():
        mine = [event[0] for event in found.events if event[0].robot == robot]
        named = [f"{utc_datetime(e.first_after):%Y-%m-%d} ({e.parameter})" for e in mine]
        print(f"  {robot} changes on {day}: {', '.join(named) or 'not found'}")
    others = [event for event in found.events if event[0].robot not in days]
    print(
        f"  other robots marked: {len(others)}; drifts: {len(found.change_test.drifts)}; "
        f"{found.change_test.tested} series tested"
    )
    print(f"  looking for changes took {looked / worked:.0%} of the time of the fits", flush=True)


def ratio(folder: Path, spec: BatchSpec) -> None:
    """Print the recordings per second of one worker, and the ratio for two workers on the same recordings."""
    seconds = {}
    for workers in (1, 2):
        (folder / f"out_{workers}").mkdir()
        began = time.perf_counter()
        done = run_batch(spec, folder / f"out_{workers}", workers=workers)
        seconds[workers] = time.perf_counter() - began
    work = sum(row.outcome.seconds for row in done.rows) / len(done.rows)
    rows = [[str(n), f"{len(done.rows) / took:.2f}", f"{seconds[1] / took:.2f}"] for n, took in seconds.items()]
    bench.print_table(
        f"{len(done.rows)} recordings, {work:.2f} s of work each, start of the workers included",
        ["workers", "per second", "ratio"], rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
