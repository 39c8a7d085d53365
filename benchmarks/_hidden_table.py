"""Common code of the tables of hidden effects: run cases in processes, compare results with the truth, print shares.

A row is a dictionary. Its truth values under the keys of `SHARES` become columns of the table; `seconds` (wall) and
`cpu` become a line on time; `pull` is (estimate - truth) / std, one or several of them; `held_out` and `in_turn` are
chi2 per sample.
"""

import argparse
import importlib
import json
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import joined_residual_blocks, predict_runs
from armdyn.identify.prepare import noise_std_by_run_and_channel
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import ResidualBlock, chi2_sum
from armdyn.identify.study import Study
from armdyn.run import Run

Row = dict[str, Any]
SHARES = ("start", "reproduced", "named", "honest", "joints", "tie", "alone", "false", "exact", "flagged")
JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint" and not effect.needs)
"""Effects of the catalogue for an arm."""
PENDULUM_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on not in ("joint", "wrench"))
"""Effects of the catalogue for a pendulum."""
SAME_TORQUE = {"joint_asymmetric_friction": ("joint_coulomb_friction", "torque_offset")}
"""Effects that together have the same torque and as many values as another effect, by that effect."""
GOOD_HELD_OUT = 1.1
"""Chi2 per sample of held-out runs up to which a repair counts as complete."""


def generator(name: str) -> Any:
    """`tests/worlds/<name>.py` as a module."""
    tests = str(Path(__file__).parents[1] / "tests")
    if tests not in sys.path:
        sys.path.insert(0, tests)
    return importlib.import_module(f"worlds.{name}")


def parser(description: str | None, what: str, seeds: int) -> argparse.ArgumentParser:
    """Parser with the options that every table has."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--seeds", type=int, default=seeds, help="of each kind")
    made.add_argument("--first-seed", type=int, default=0)
    made.add_argument("--processes", type=int, default=1)
    made.add_argument("--what", default=what, help="kinds of cases, with commas")
    made.add_argument("--only", default="", help="effects, with commas")
    made.add_argument("--json", type=Path, default=None, help="every row")
    return made


def wanted(what: str, kinds: Sequence[str]) -> list[str]:
    """Names of an option, separated by commas; an unknown name ends the program with an error message."""
    names = [name.strip() for name in what.split(",")]
    for name in names:
        if name not in kinds:
            sys.stderr.write(f"--what {name}: choose from {', '.join(kinds)}\n")
            raise SystemExit(2)
    return names


def answered(case: Callable[..., Row], arguments: Sequence[tuple[Any, ...]], processes: int) -> Iterator[Row]:
    """Rows of `case(*arguments)`, in order; `case` is a function of a module, so that processes can find it."""
    if processes == 1:
        yield from (case(*given) for given in arguments)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(case, *zip(*arguments, strict=True))


def judged(found: Diagnosis, truth: str) -> Row:
    """Whether the first name is right; it or a reported tie; whether there is a tie; whether no other name is given."""
    first = found.ranked_effects[0] if found.ranked_effects else None
    if first is None or found.verdict.key not in ("effect_missing", "cannot_tell_apart"):
        return {"named": False, "honest": False, "tie": False, "alone": False}
    tie = found.verdict.key == "cannot_tell_apart"
    named = first.effect == truth
    last = found.search.last
    return {
        "named": named,
        "honest": named or (tie and truth in first.tied_with),
        "tie": tie,
        "alone": len(last.effects) == len(found.search.steps[0].effects) + 1,
    }


def held_out_chi2(study: Study, fit: Fit, fresh: Sequence[Run]) -> Row:
    """Chi2 per sample of runs that took part in no fit, and of the fit's own runs, each predicted from the others.

    The second fits again to fewer runs, so that it is the larger one where one run teaches little. Neither is asked for
    where there is no fresh run.
    """
    if not fresh:
        return {}
    noise = noise_std_by_run_and_channel(study.model, fresh)
    problem = replace(fit, problem=Problem(fit.problem.model, fit.problem.runs, {**fit.problem.noise, **noise}))
    chi2 = {}
    for key, blocks in (
        ("held_out", joined_residual_blocks(predict_runs(problem, fresh))),
        ("in_turn", study.held_out_blocks(fit)),
    ):
        chi2[key] = chi2_per_sample(blocks) if blocks else None
    return chi2


def chi2_per_sample(blocks: Sequence[ResidualBlock]) -> float:
    """Sum of the squared residuals, in standard deviations of the noise, over the number of samples."""
    return chi2_sum(blocks) / sum(len(block.residual) for block in blocks)


def kept(file: Path | None, make: Callable[[], Any]) -> Any:
    """Result of `make`; it is read from the file if that exists and written to it otherwise; None means no file."""
    if file is not None and file.exists():
        with file.open("rb") as stream:
            return pickle.load(stream)
    made = make()
    if file is not None:
        with file.open("wb") as stream:
            pickle.dump(made, stream)
    return made


def by_effect(
    description: str, effects: Iterable[str], case: Callable[[str, int], Any], seeds: int = 10
) -> tuple[argparse.Namespace, dict[str, list[Any]]]:
    """Read the options and answer `case(effect, seed)` for all of them: the options, and the answers by effect."""
    options = parser(description, "", seeds).parse_args()
    chosen = options.only.split(",") if options.only else list(effects)
    pairs = [(effect, seed) for seed in seeds_of(options) for effect in chosen]
    done: dict[str, list[Any]] = {effect: [] for effect in chosen}
    for (effect, _), answer in zip(pairs, answered(case, pairs, options.processes), strict=True):
        done[effect].append(answer)
        sys.stderr.write(f"  {answer}\n")
    return options, done


def seeds_of(options: argparse.Namespace) -> range:
    """Seeds that the options select."""
    return range(options.first_seed, options.first_seed + options.seeds)


def table(title: str, rows: Sequence[Row]) -> None:
    """Print the cases of one kind: a line for each hidden effect, then a line for all of them."""
    print(f"\n{title}: {len(rows)} cases")
    for name in dict.fromkeys(row["what"] for row in rows):
        mine = [row for row in rows if row["what"] == name]
        columns = [f"{key} {_share(mine, key)}" for key in SHARES if any(key in row for row in mine)]
        print(f"  {name:44s}" + "  ".join([*columns, *_good(mine)]), flush=True)
    for key in SHARES:
        if any(key in row for row in rows):
            print(f"  all: {key} {_share(rows, key)}")
    untied = [row for row in rows if row.get("tie") is False and "named" in row]
    if untied:
        print(f"  where no tie was reported: named {_share(untied, 'named')} of {len(untied)}")
    for key, text in (("pull", "true value of the effect's parameter"), ("length_pull", "true length")):
        given = [np.atleast_1d(row[key]) for row in rows if row.get(key) is not None]
        pulls = np.abs(np.concatenate(given)) if given else np.array([])
        if len(pulls):
            print(f"  {text} within 3 std: {100 * np.mean(pulls < 3):.1f} % of {len(pulls)}")
    for key, text in (("held_out", "a fresh run's"), ("in_turn", "runs held out in turn:")):
        values = np.array([row[key] for row in rows if row.get(key) is not None])
        if len(values):
            good = f"{100 * np.mean(values <= GOOD_HELD_OUT):.1f} %"
            print(f"  {text} chi2 per sample <= {GOOD_HELD_OUT}: {good} of {len(values)}, worst {max(values):.2f}")
    for key, text in (("seconds", "wall"), ("cpu", "processor")):
        taken = np.array([row[key] for row in rows if key in row])
        if len(taken):
            print(
                f"  {text} seconds: median {np.median(taken):.2f}, 95 % {np.percentile(taken, 95):.2f}, "
                f"worst {np.max(taken):.2f}; above 2: {100 * np.mean(taken > 2):.0f} %", flush=True,
            )  # fmt: skip


def show_shares(shares: Mapping[str, tuple[float, int]], targets: Mapping[str, float]) -> None:
    """Print shares, each with its number of cases, beside their targets."""
    for what, (share, count) in shares.items():
        print(f"{what}: {100 * share:.1f} % of {count}, wanted {100 * targets[what]:.0f} %")


def missed(row: Row) -> bool:
    """Whether a row has a false alarm, or a name or a start that is wrong."""
    return bool(row.get("false")) or any(row.get(key) is False for key in ("start", "honest", "exact", "flagged"))


def save(path: Path | None, everything: Mapping[str, Sequence[Row]]) -> None:
    """Write all rows as JSON, if a file is given."""
    if path is not None:
        path.write_text(json.dumps(everything, indent=1, default=_plain))


def run(
    kinds: Mapping[str, tuple[Callable[..., Row], Sequence[tuple[Any, ...]]]], processes: int, path: Path | None
) -> None:
    """Answer and print kinds of cases, each a function and what to call it with; the file grows kind by kind."""
    everything: dict[str, list[Row]] = {}
    for kind, (case, arguments) in kinds.items():
        rows = everything[kind] = []
        for row in answered(case, arguments, processes):
            rows.append(row)
            if missed(row):
                print("   miss:", {k: v for k, v in row.items() if k not in ("seconds", "cpu")}, flush=True)
        table(kind, rows)
        save(path, everything)


def _share(rows: Sequence[Row], key: str) -> str:
    values = [bool(row[key]) for row in rows if key in row]
    return f"{100 * np.mean(values):5.1f} %" if values else "  –"


def _good(rows: Sequence[Row]) -> list[str]:
    values = [row["held_out"] <= GOOD_HELD_OUT for row in rows if row.get("held_out") is not None]
    return [f"held out {100 * np.mean(values):5.1f} %"] if values else []


def _plain(value: object) -> object:
    return value.item() if isinstance(value, np.generic) else str(value)
