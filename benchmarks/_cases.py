"""A benchmark that does the same for every hidden effect and seed, in processes."""

import argparse
import multiprocessing
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TypeVar

Case = TypeVar("Case")


def cases(
    description: str, effects: Iterable[str], work: Callable[[str, int], Case]
) -> tuple[argparse.Namespace, dict[str, list[Case]]]:
    """Read the options and do the work, seed after seed.

    Args:
        description: the benchmark's docstring.
        effects: all that there are; `--only` chooses some.
        work: what is done with an effect and a seed.

    Returns:
        The options `seeds` and `json` among others, and the cases of every effect.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="of each effect")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--only", default=",".join(effects), help="effects, with commas")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    chosen = options.only.split(",")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    pairs = [(effect, seed) for seed in seeds for effect in chosen]
    done: dict[str, list[Case]] = {effect: [] for effect in chosen}
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        for (effect, _), case in zip(pairs, pool.map(work, *zip(*pairs, strict=True)), strict=True):
            done[effect].append(case)
            print(f"  {case}", file=sys.stderr, flush=True)
    return options, done
