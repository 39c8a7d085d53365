"""Are laws of kinds that no shape lists found in small bases of one's own?

    python benchmarks/hidden/strange_laws.py [--first SEED] [--seeds N] [--kinds NAMES] [--clean N] [--out FILE]

Recordings come from `tests/worlds/strange_laws.py`: 25 laws in five bases, whose start values are off, and the same
bases without a law. Two recordings are fitted, one takes part in choosing. After `discover` its file is written, read
as a user's and added, and a recording that took part in nothing is predicted: its error over the noise. A law that is
found where none is hidden is false. Seeds below 100 were used to build it.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

from discover import effects_found, largest_error  # that of this folder, which also puts `worlds` on the path
from worlds.strange_laws import BASES, LAWS, world

from armdyn.discovery.discover import discover as discover_law
from armdyn.errors import ArmdynError
from armdyn.identify.repair import add
from armdyn.identify.studies import make_study

WITHIN = 1.2
"""Largest error of a good prediction over the noise."""


def judged(kind: str, seed: int) -> dict[str, object]:
    """Row of one case: errors over the noise as given and with what was found, its sentences and its time."""
    given = world(kind, seed)
    *runs, held_out, exam = given.runs
    begun = time.process_time()
    row: dict[str, object] = {"kind": kind, "seed": seed, "before": None, "after": None, "laws": 0, "found": []}
    with tempfile.TemporaryDirectory() as folder:
        model = given.model(Path(folder))
        try:
            found = discover_law(make_study(model, runs, [held_out], ()))
            row |= {"laws": len(found.laws), "found": [law.sentence for law in found.laws]}
            row["seconds"] = round(time.process_time() - begun, 1)
            for name, effects in (("before", []), ("after", effects_found(model, found, Path(folder)))):
                study = make_study(model, runs, [held_out], effects, [exam])
                row[name] = round(largest_error(study.exam_blocks(add(study, effects).steps[-1].fit)), 2)
        except ArmdynError as error:
            row |= {"seconds": round(time.process_time() - begun, 1), "refused": str(error)[:200]}
    return row


def main() -> None:
    """Print a row for each case, and how many are well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=100, metavar="SEED")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="seeds of every law")
    parser.add_argument("--kinds", default=",".join(LAWS), help="laws, with commas; empty for none")
    parser.add_argument("--clean", type=int, default=4, metavar="N", help="seeds of every base without a law")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write every row to this file too")
    chosen = parser.parse_args()
    kinds = [kind for kind in chosen.kinds.split(",") if kind]
    cases = [(kind, chosen.first + k) for k in range(chosen.seeds) for kind in kinds]
    cases += [(base, chosen.first + k) for k in range(chosen.clean) for base in BASES]
    rows = []
    for kind, seed in cases:
        rows.append(judged(kind, seed))
        print(json.dumps(rows[-1]), flush=True)
        if chosen.out is not None:
            with chosen.out.open("a") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
    laws, clean = ([row for row in rows if (row["kind"] in LAWS) == hidden] for hidden in (True, False))
    if laws:
        good = sum(row["after"] is not None and row["after"] <= WITHIN for row in laws)
        print(f"{good} of {len(laws)} within {WITHIN} of the noise; median of the others as given "
              f"{sorted(row['before'] or 0.0 for row in laws)[len(laws) // 2]}")  # fmt: skip
    if clean:
        print(f"a false law in {sum(row['laws'] > 0 for row in clean)} of {len(clean)} clean ones")
    seconds = sorted(row["seconds"] for row in rows)
    print(f"processor time: median {seconds[len(seconds) // 2]:.0f} s, worst {seconds[-1]:.0f} s")


if __name__ == "__main__":
    main()
