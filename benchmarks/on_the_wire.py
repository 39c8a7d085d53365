"""Does the load land over a real ROS master and a real rosbridge, in real time, from each of the paper's guesses?

    ARMDYN_ROS_KIT=KIT python benchmarks/on_the_wire.py [--guesses 0.308,0.468] [--hidden quadratic_drag=0.05]

Master and bridge, twin, and trial run in processes of their own; the twin knows the truth. With `--hidden` the twin has
an effect that the robot's model lacks. A last column says how long this machine kept a real-time thread from running.
On a machine that does so for longer than a trial may be silent (30 ms), `--again N` tries a guess again whose trial
was ended for that; every try is counted, and what ended it is printed.
"""

import _timing as bench  # isort: skip

import argparse
import resource
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from armdyn.errors import ArmdynError
from armdyn.run import read_run
from pipeline.trial.table import STRING_LENGTH_GUESSES

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from ros_wire.wire import Stalls, TracedTwin, Trial, Wire, missing

WITHIN = 1e-3
"""Largest error of the length in the claim [m]."""
LATE = ("loop stood still", "too old", "no command for", "watchdog stopped the arm")
"""Parts of the messages of trials that ended because a message came too late."""


def busy() -> float:
    """Processor time of all ended child processes [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def one(guess: float, seed: int, hidden: list[str], options: list[str], keep: Path | None) -> dict[str, object]:
    """Result of one trial in three processes."""
    with TemporaryDirectory() as scratch:
        folder, stalls, before = keep or Path(scratch), Stalls(), busy()
        folder.mkdir(parents=True, exist_ok=True)
        with Wire() as wire, TracedTwin(wire, folder, seed, hidden) as twin:
            with Trial(wire, twin, folder, "--length-guess", str(guess), *options) as trial:
                status, said, answer = trial.wait()
            trace = twin.end()
        stalls.close()
        try:
            samples = len(read_run(trial.out / "trial.mcap").channels["load_force"])
        except (ArmdynError, OSError):
            samples = 0
    answer = answer or {}
    robot = answer.get("robot") or {}
    estimate = answer.get("length_estimate")
    return {
        "guess": guess,
        "tries": 1,
        "landed": bool(trace["load_in_box"]) and status == 0,
        "error": None if estimate is None else float(estimate - trace["length"]),
        "samples": samples,
        "lost": int(robot.get("commands", 0)) - len(trace["received"]),
        "missed": answer.get("missed_cycles"),
        "robot": robot,
        "nodes": answer.get("nodes"),
        "busy": busy() - before,
        "stall": stalls.worst,
        "said": answer.get("message") or " ".join(said.split())[-300:],
        "notes": answer.get("notes"),
    }


def tried(guess: float, again: int, *arguments: object) -> dict[str, object]:
    """Result of a trial, repeated up to `again` times while late messages end it."""
    for tries in range(1, again + 2):
        row = one(guess, *arguments) | {"tries": tries}
        print(f"  {guess:g}: {row['said']}", file=sys.stderr, flush=True)
        if row["landed"] or not any(words in str(row["said"]) for words in LATE):
            break
    return row


def milliseconds(row: dict[str, object], name: str) -> str:
    """Median, 95 %, 99 % and largest of a duration that the robot measured, as text in milliseconds."""
    robot = row["robot"]
    spread = robot.get(name) if isinstance(robot, dict) else None
    return "" if not spread else " ".join(f"{1e3 * spread[k]:.1f}" for k in ("median", "p95", "p99", "worst"))


def main() -> int:
    """Print the table; 1 where a claim is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--guesses", default=",".join(map(str, STRING_LENGTH_GUESSES)), help="of the length [m]")
    parser.add_argument("--hidden", action="append", default=[], help="EFFECT=VALUE of the twin")
    parser.add_argument("--seed", type=int, default=0, help="of the first twin; the next ones follow")
    parser.add_argument("--model", type=Path, help="model file of the robot, such as a repaired one")
    parser.add_argument("--keep", type=Path, help="folder for recordings; nothing is kept if not given")
    parser.add_argument("--again", type=int, default=0, metavar="N", help="tries after one that was ended late")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    reason = missing()
    if reason is not None:
        print(reason, file=sys.stderr)
        return 2
    given = ["--model", str(options.model.resolve())] if options.model else []
    rows = []
    for k, text in enumerate(options.guesses.split(",")):
        keep = options.keep / text if options.keep else None
        rows.append(tried(float(text), options.again, options.seed + k, options.hidden, given, keep))
    bench.print_table(
        "Trials over ROS (intervals and ages: median, 95 %, 99 %, worst, ms)",
        [
            "guess m", "tries", "landed", "error mm", "lost", "missed", "command interval", "state age", "CPU s",
            "stall ms",
        ],
        [
            [
                f"{row['guess']:g}", str(row["tries"]), "yes" if row["landed"] else "no",
                "" if row["error"] is None else f"{1e3 * row['error']:+.2f}", str(row["lost"]), str(row["missed"]),
                milliseconds(row, "command_interval"), milliseconds(row, "state_age"), f"{row['busy']:.0f}",
                f"{1e3 * row['stall']:.0f}",
            ]
            for row in rows
        ],
    )  # fmt: skip
    landed, tries = sum(row["landed"] is True for row in rows), sum(int(str(row["tries"])) for row in rows)
    errors = [abs(row["error"]) for row in rows if isinstance(row["error"], float)]
    claims = [
        bench.Claim("every load lands", f"{landed} of {len(rows)}, in {tries} tries", landed == len(rows)),
        bench.Claim("every recording can be read", "", all(row["samples"] for row in rows)),
    ]
    if not options.hidden:
        worst = max(errors, default=np.inf)
        claims.append(bench.Claim("every length within 1 mm", f"worst {1e3 * worst:.2f} mm", worst <= WITHIN))
    return bench.conclude(claims, {"rows": rows}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
