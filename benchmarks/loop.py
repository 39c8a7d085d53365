"""Does the loop close: a hidden effect makes a swing miss, its recording repairs the model, and the next swing lands?

    python benchmarks/loop.py [--seeds N] [--first-seed N] [--workers N] [--only EFFECT,...] [--json FILE]

For every effect and seed: a trial whose plant has an effect that the model lacks; `repair` of the model that the robot
had, on the recording of that trial alone; a trial with the repaired model on the same plant; and one on another plant,
with another mass, latency, bias and noise. "named" is the share of repairs that added this effect and no other.
"""

import _timing as bench  # isort: skip

from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from _hidden_table import by_effect

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.model_file import read_model
from armdyn.pendulum.model import PendulumModel
from armdyn.run import read_run
from pipeline.trial import TrialSettings, run_trial

HIDDEN = {
    "quadratic_drag": ("coefficient", 0.05), "string_creep": ("rate", 1e-3), "wind": ("force", 0.2),
    "load_inertia": ("inertia", 4e-3), "gripper_lag": ("time", 0.09), "pivot_viscous_friction": ("coefficient", 7e-3),
}  # fmt: skip
"""Parameter and value [SI units] by effect, so large that the robot's usual model mostly misses the box."""
ELSEWHERE = 1000
"""Offset of the seed for the other plant."""


@dataclass(frozen=True)
class Case:
    """Result of one loop; `value` is the found value over the true one, nan where the effect was not found."""

    effect: str
    seed: int
    missed: bool
    added: tuple[str, ...]
    value: float
    chi2: tuple[float, float]
    landed: bool
    landed_elsewhere: bool


def turn(effect: str, seed: int) -> Case:
    """One loop: a first swing, a repair, a second swing."""
    parameter, size = HIDDEN[effect]
    with TemporaryDirectory() as scratch:
        out = Path(scratch)
        unaware = run_trial(TrialSettings(hidden={effect: size}, seed=seed, out=out))
        model, run = read_model(out / "model.toml"), read_run(out / "trial.csv")
    catalogue = [e for e in CATALOGUE.values() if e.acts_on in model.stages]
    found = repair(make_study(model, [run], [], catalogue))
    repaired = found.model
    assert isinstance(repaired, PendulumModel)

    def lands(plant: int) -> bool:
        guess = repaired.value("length")
        return run_trial(TrialSettings(hidden={effect: size}, seed=plant, model=repaired, length_guess=guess)).success

    had = {e.name for e in model.effects}
    added = tuple(e.name for e in repaired.effects if e.name not in had)
    name = f"{effect}.{parameter}"
    value = repaired.value(name) / size if effect in added else float("nan")
    chi2 = (found.path[0].chi2_per_sample, found.path[-1].chi2_per_sample)
    return Case(effect, seed, not unaware.success, added, value, chi2, lands(seed), lands(seed + ELSEWHERE))


def row(effect: str, mine: list[Case]) -> list[str]:
    """Line of the table for one effect."""
    ratio = np.array([c.value for c in mine])
    ratio = ratio[np.isfinite(ratio)]
    before, after = (np.median([c.chi2[i] for c in mine]) for i in (0, 1))
    return [
        f"{effect} {HIDDEN[effect][1]:g}",
        f"{np.mean([c.missed for c in mine]):.0%}",
        f"{np.mean([c.added == (effect,) for c in mine]):.0%}",
        f"{np.mean(ratio):.3f} +/- {np.std(ratio):.3f}" if len(ratio) else "-",
        f"{before:.3g} to {after:.3g}",
        f"{np.mean([c.landed for c in mine]):.0%}",
        f"{np.mean([c.landed_elsewhere for c in mine]):.0%}",
    ]


def main() -> int:
    """Run the benchmark and print the table; there are no claims."""
    options, of = by_effect(__doc__, HIDDEN, turn)
    bench.print_table(
        f"Miss, repair, land: {options.seeds} seeds each",
        ["hidden", "missed", "named", "value / truth", "chi2 per sample", "lands", "lands on another plant"],
        [row(effect, mine) for effect, mine in of.items()],
    )
    return bench.conclude([], {"cases": [asdict(c) for mine in of.values() for c in mine]}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
