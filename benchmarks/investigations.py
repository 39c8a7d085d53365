"""Does a robot find by itself which effect its model lacks, and then land the load?

    python benchmarks/investigations.py [--seeds N] [--first-seed N] [--processes N] [--only EFFECT,...] [--json FILE]

For every effect and seed: `armdyn trial --investigate 3 --hidden EFFECT=VALUE`. The plant is MuJoCo's and shares no
code with the models; arm, delays and encoders are as in any trial. Right is: the verdict that stands names the hidden
effect and no other; or it names none, or several with the hidden one, where the effect is too small for the recordings.
That is so where its true size is below the detection limit that follows from the Fisher information at the true values,
with the noise that the true model leaves; the verdict has no part in it. An effect "ties" where the first experiment
leaves more than one candidate.
"""

import _timing as bench  # isort: skip

from collections import Counter
from dataclasses import asdict, dataclass, replace

import numpy as np
from _hidden_table import by_effect

from armdyn.effects.catalogue import CATALOGUE
from armdyn.experiments.detection import detection_limit
from armdyn.identify.studies import make_study
from armdyn.run import Run
from pipeline.robot.truth import TruePlantParameters
from pipeline.trial import TrialSettings, simulate_trial
from pipeline.trial.investigation import InvestigationEndReason, investigated_model

HIDDEN = {
    "pivot_viscous_friction": 1e-3, "linear_drag": 0.01, "quadratic_drag": 0.05, "pivot_coulomb_friction": 2e-3,
    "sensor_lag": 0.02, "gripper_lag": 0.03, "string_elasticity": 5e-3, "cross_axis_sensitivity": 0.05,
    "load_inertia": 1e-3, "sensor_gain": 0.05, "sensor_drift": 2e-3, "sensor_nonlinearity": 0.1,
    "vertical_sensing_axis": 1.0, "string_creep": 5e-4, "gripper_scale": 0.05, "gripper_bob": 1.0,
    "gripper_compliance": 0.015, "string_mass": 0.02,
}  # fmt: skip
"""Values in SI units, of a usual size: all that the plant can hide, but for bias and delay, which every trial fits, and
for wind and a tilted line, which no motion tells apart."""
EXPERIMENTS = 3


OPEN_ENDS = tuple(InvestigationEndReason[name].name for name in ("EXPLAINED", "INSEPARABLE", "SPENT"))


@dataclass(frozen=True)
class Case:
    """One investigation; `first` and `last` are the candidates after the first and the last experiment.

    `limit` is the detection limit of the hidden effect in all recordings, at the true values.
    """

    effect: str
    seed: int
    stop: str
    experiments: int
    first: tuple[str, ...]
    last: tuple[str, ...]
    landed: bool
    limit: float

    @property
    def named(self) -> bool:
        """Whether the hidden effect and no other was named."""
        return self.stop == InvestigationEndReason.NAMED.name and self.last == (self.effect,)

    @property
    def right(self) -> bool:
        """Whether the verdict is right: the effect is named, or too small to be."""
        open_end = self.stop in OPEN_ENDS and (not self.last or self.effect in self.last)
        return self.named or (open_end and HIDDEN[self.effect] < self.limit)


def investigation(effect: str, seed: int) -> Case:
    """Investigate, then swing the load into the box."""
    settings = TrialSettings(hidden={effect: HIDDEN[effect]}, seed=seed, investigate=EXPERIMENTS)
    trial = simulate_trial(settings)
    found = trial.result.investigation
    assert found is not None, "it was asked for"
    first, last = (found.stages[k].candidates if found.stages else () for k in (0, -1))
    limit = true_detection_limit(settings, trial.robot.truth, effect, [stage.run for stage in found.stages])
    return Case(effect, seed, found.stop.name, len(found.stages), first, last, trial.result.success, limit)


def true_detection_limit(settings: TrialSettings, truth: TruePlantParameters, effect: str, runs: list[Run]) -> float:
    """Detection limit of the hidden effect in the recordings, at the true values of load, string and effect."""
    study = make_study(investigated_model(settings), runs, [], tuple(CATALOGUE.values()))
    (mine,) = (c for c in study.candidates if c.effect == effect)
    fitted = study.fit_base_with_effects((*study.present, mine))
    true = {"length": truth.length, "mass": truth.mass, mine.names[0]: HIDDEN[effect]}
    values = [true.get(c.parameter.name, value) for c, value in zip(study.problem.columns, fitted.values, strict=True)]
    return detection_limit(study, replace(fitted, values=np.array(values)), mine).size


def row(effect: str, mine: list[Case]) -> list[str]:
    """Line of the table for one effect."""
    others = Counter("+".join(c.last) or c.stop.lower() for c in mine if not c.named)
    limits = [c.limit for c in mine]
    return [
        f"{effect} {HIDDEN[effect]:g}",
        f"{min(limits):.2g} to {max(limits):.2g}",
        ", ".join(f"{n} {what}" for what, n in others.most_common()) or "-",
        str(len(mine)),
        str(sum(len(c.first) > 1 for c in mine)),
        str(sum(c.named for c in mine)),
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
        ["hidden", "detection limit", "otherwise", "runs", "ties at first", "named", "right", "experiments", "land"],
        [row(effect, mine) for effect, mine in of.items()],
        texts=3,
    )
    right, landed = sum(c.right for c in done), sum(c.landed for c in done)
    claims = [
        bench.Claim("the verdict is right", f"{right} of {len(done)}", right >= 0.90 * len(done)),
        bench.Claim("the load lands", f"{landed} of {len(done)}", landed >= 0.95 * len(done)),
    ]
    return bench.conclude(claims, {"cases": [asdict(c) for c in done]}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
