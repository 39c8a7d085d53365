"""Is a sound recording of an imperfect arm ever refused? Prints what is said of each.

    python benchmarks/hidden/sound_arms.py --arms 68 --first-seed 0

Three recordings each of `sound_recordings.owned` of `tests/worlds`: arms that are imperfect everywhere, with
series-elastic drives, torque constants that are a guess, payloads and springs in any combination.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip
import _timing as bench  # isort: skip

import time
from collections import Counter

from armdyn.arm.model import arm_model
from armdyn.inspection.check import Severity
from armdyn.inspection.inspect import inspect_runs

recorded = hidden_table.generator("sound_recordings")


def main() -> int:
    parser = bench.argparse.ArgumentParser(
        description=__doc__, formatter_class=bench.argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", type=int, default=68, help="of three recordings each")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    wrong, suspect, count, seconds = 0, 0, 0, 0.0
    kinds: Counter[str] = Counter()
    for seed in range(options.first_seed, options.first_seed + options.arms):
        robot = recorded.ROBOTS[seed % len(recorded.ROBOTS)]
        runs = [sound.run for sound in recorded.owned(robot, seed)]
        model = arm_model(robot=robot, joints=recorded.Plant(robot).joints)
        begun = time.process_time()
        found = inspect_runs(runs, model)
        seconds += time.process_time() - begun
        refused, doubted = ({c.run for c in found.with_severity(s)} for s in (Severity.WRONG, Severity.SUSPECT))
        wrong, suspect, count = wrong + len(refused), suspect + len(doubted - refused), count + len(runs)
        for check in (*found.wrong, *found.with_severity(Severity.SUSPECT)):
            kinds[check.kind] += 1
            print(f"{check.run}: {check.severity.key} {check.kind}: {check.sentence[:150]}", flush=True)
    print(f"{wrong} refused, {suspect} suspect of {count}; {seconds / count:.2f} s of processor time a recording")
    claims = [bench.Claim("no sound recording is refused", f"{wrong} of {count}", wrong == 0)]
    return bench.conclude(claims, {"wrong": wrong, "suspect": suspect, "count": count, "kinds": kinds}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
