"""The table of a benchmark of the watch: happenings of every kind on every robot, and work where nothing happens."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from _hidden_table import Row


@dataclass(frozen=True)
class WatchTable:
    """What a benchmark asks.

    Attributes:
        about: its documentation.
        robots: names of the robots.
        kinds: kinds of happenings.
        seeds: usual number of seeds.
        each: usual number of happenings of each kind, robot and seed.
        quiet: option for the work where nothing happens, and its usual value, in the option's unit.
        happened: ``(robot, seed, rate, kind, number, false alarms per hour)`` to a row.
        silent: ``(robot, seed, rate, value of the quiet option, false alarms per hour)`` to a row.
        show: prints all rows so far.
    """

    about: str
    robots: Sequence[str]
    kinds: Sequence[str]
    seeds: int
    each: int
    quiet: tuple[str, float]
    happened: Callable[[str, int, float, str, int, float], Row]
    silent: Callable[[str, int, float, float, float], Row]
    show: Callable[[Sequence[Row]], None]

    def main(self) -> None:
        """Read the options, and print the table after each robot and seed."""
        parser = argparse.ArgumentParser(description=self.about.splitlines()[0])
        option, usual = self.quiet
        parser.add_argument("--robots", default=",".join(self.robots), help="with commas")
        parser.add_argument("--seeds", type=int, default=self.seeds)
        parser.add_argument("--first-seed", type=int, default=0)
        parser.add_argument("--only", default=",".join(self.kinds), help="with commas")
        parser.add_argument("--each", type=int, default=self.each, help="happenings of each kind, robot and seed")
        parser.add_argument(
            f"--{option}", type=type(usual), default=usual, help="of work where nothing happens, by robot and seed"
        )
        parser.add_argument("--rate", type=float, default=500.0, help="samples per second")
        parser.add_argument("--per-hour", type=float, default=0.01, help="false alarms that are asked for")
        parser.add_argument("--json", type=Path, help="rows, written after each")
        given = parser.parse_args()
        rows, quiet = list[Row](), getattr(given, option)
        for name in given.robots.split(","):
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                for what in given.only.split(","):
                    rows += [self.happened(name, seed, given.rate, what, k, given.per_hour) for k in range(given.each)]
                rows += [self.silent(name, seed, given.rate, quiet, given.per_hour)] if quiet else []
                if given.json:
                    given.json.write_text(json.dumps(rows, indent=1))
                self.show(rows)
                sys.stdout.flush()
