"""Does a robot find by itself which effect its model lacks, and then land the load?

    python benchmarks/investigations.py [--seeds N] [--first-seed N] [--processes N] [--only EFFECT,...] [--json FILE]

For every effect and seed: `armdyn trial --investigate 4 --hidden EFFECT=VALUE`. The plant is MuJoCo's and shares no
code with the models; arm, delays and encoders are as in any trial. Right is: the verdict that stands names the hidden
effect and no other. An effect "ties" where the first experiment leaves more than one candidate.
"""

import _timing as bench  # isort: skip

from collections import Counter
from dataclasses import asdict, dataclass

import numpy as np
from _hidden_table import by_effect

from pipeline.trial import TrialSettings, simulate_trial
from pipeline.trial.investigation import InvestigationEndReason

HIDDEN = {
    "pivot_viscous_friction": 1e-3, "linear_drag": 0.01, "quadratic_drag": 0.05, "pivot_coulomb_friction": 2e-3,
    "sensor_lag": 0.02, "gripper_lag": 0.03, "string_elasticity": 5e-3, "cross_axis_sensitivity": 0.05,
    "load_inertia": 1e-3, "sensor_gain": 0.05, "sensor_drift": 2e-3, "sensor_nonlinearity": 0.1,
    "vertical_sensing_axis": 1.0, "string_creep": 5e-4, "gripper_scale": 0.05, "gripper_bob": 1.0,
}  # fmt: skip
"""Values in SI units, of a usual size: all that the plant can hide, but for bias and delay, which every trial fits, and
for wind and a tilted line, which no motion tells apart."""
EXPERIMENTS = 4


@dataclass(frozen=True)
class Case:
    """One investigation; `first` and `last` are the candidates after the first and the last experiment."""

    effect: str
    seed: int
    stop: str
    experiments: int
    first: tuple[str, ...]
    last: tuple[str, ...]
    landed: bool

    @property
    def right(self) -> bool:
        """Whether the hidden effect and no other was named."""
        return self.stop == InvestigationEndReason.NAMED.name and self.last == (self.effect,)


def investigation(effect: str, seed: int) -> Case:
    """Investigate, then swing the load into the box."""
    trial = simulate_trial(TrialSettings(hidden={effect: HIDDEN[effect]}, seed=seed, investigate=EXPERIMENTS))
    found = trial.result.investigation
    assert found is not None, "it was asked for"
    first, last = (found.stages[k].candidates if found.stages else () for k in (0, -1))
    return Case(effect, seed, found.stop.name, len(found.stages), first, last, trial.result.success)


def row(effect: str, mine: list[Case]) -> list[str]:
    """Line of the table for one effect."""
    others = Counter("+".join(c.last) or c.stop.lower() for c in mine if not c.right)
    return [
        f"{effect} {HIDDEN[effect]:g}",
        ", ".join(f"{n} {what}" for what, n in others.most_common()) or "-",
        str(len(mine)),
        str(sum(len(c.first) > 1 for c in mine)),
        str(sum(c.right for c in mine)),
        f"{np.mean([c.experiments for c in mine]):.1f}",
        str(sum(c.landed for c in mine)),
    ]


def main() -> int:
    """Run the benchmark; 1 where a claim is missed."""
    options, of = by_effect(__doc__, HIDDEN, investigation)
    done = [case for mine in of.values() for case in mine]
    bench.print_table(
        f"Investigations of at most {EXPERIMENTS} experiments",
        ["hidden", "named otherwise", "runs", "ties at first", "right", "experiments", "land"],
        [row(effect, mine) for effect, mine in of.items()],
        texts=2,
    )
    right, landed = sum(c.right for c in done), sum(c.landed for c in done)
    claims = [
        bench.Claim("the hidden effect is named", f"{right} of {len(done)}", right >= 0.95 * len(done)),
        bench.Claim("the load lands", f"{landed} of {len(done)}", landed >= 0.95 * len(done)),
    ]
    return bench.conclude(claims, {"cases": [asdict(c) for c in done]}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
