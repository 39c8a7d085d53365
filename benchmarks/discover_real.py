"""What does `discover` find in public recordings, beside what a repair by the catalogue leaves, and is it believed?

    python benchmarks/discover_real.py --data DIR --sets cup,emps

The recordings are not in the repository; the sets are those of `real.py` and `real_arms.py`, thinned to 100 Hz. Each is
repaired; where more than twice the noise is left, a law is looked for beside the effects that the repair found. Errors
are the root mean square over the noise, largest over channels, of the runs that were fitted, of the held-out ones,
which take part in choosing, and of the exam, which takes part in nothing; each before and after what was discovered.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent / "hidden"))
from discover import effects_found, largest_error  # isort: skip

import json
import tempfile
import time
from argparse import ArgumentParser
from dataclasses import replace

import _timing as bench
import numpy as np
import real as pendulums
import real_arms as arms
from _hidden_table import JOINT_EFFECTS

from armdyn.arm.model import arm_model
from armdyn.discovery.discover import discover
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.identify.fit import Fit
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.model import Model
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run, read_run

RATE = 100.0
"""Rate of the recordings after thinning [Hz]; a swing lasts about a second."""
LEFT = 2.0
"""Least error after a repair, over the noise, from which a law is searched."""
SETS: dict[str, pendulums.Recorded | arms.Recorded] = {
    **{one.name: one for one in pendulums.SETS},
    **{one.folder: one for one in arms.SETS},
}


def judged(name: str, data: Path) -> dict[str, object]:
    """Result for one set: effects of the repair, remaining error, laws found in addition, errors before and after."""
    of, begun = SETS[name], time.process_time()
    folder, exams = data / of.folder, of.exam if isinstance(of.exam, tuple) else (of.exam,)
    runs, held_out, exam = (
        [thinned(folder / f"{s}.csv") for s in stems] for stems in (of.training, of.held_out, exams)
    )
    model, catalogue = given(of, folder)
    repaired = repair(make_study(model, runs, held_out, catalogue, exam)).model
    study = make_study(repaired, runs, held_out, (), exam)
    before = errors(study, study.first())
    row: dict[str, object] = {"set": name, "repaired": [effect.label for effect in repaired.effects], "before": before}
    if before["fitted"] > LEFT:
        found = discover(make_study(repaired, runs, held_out, catalogue))
        with tempfile.TemporaryDirectory() as file:
            effects = effects_found(repaired, found, Path(file))
        study = make_study(repaired, runs, held_out, effects, exam)
        row |= {"found": [one.sentence for one in found.laws], "sentence": found.sentence}
        row |= {"after": errors(study, add(study, effects).steps[-1].fit)}
    return row | {"seconds": round(time.process_time() - begun)}


def given(of: pendulums.Recorded | arms.Recorded, folder: Path) -> tuple[Model, list[Effect]]:
    """Model of a set as given, and the effects to choose from."""
    if isinstance(of, pendulums.Recorded):
        return pendulum_model(pendulums.LENGTH, pendulums.MASS), list(CATALOGUE.values())
    file = folder / of.robot
    model = arm_model(file) if file.exists() else arm_model(robot=of.robot)
    return model, list(JOINT_EFFECTS)


def thinned(file: Path) -> Run:
    """Run of a recording with at most the rate `RATE`."""
    run = read_run(file)

    def every(channel: Channel) -> Channel:
        step = max(1, round(1.0 / (RATE * float(np.median(np.diff(channel.time))))))
        return Channel(channel.time[::step], channel.value[::step], channel.unit)

    return replace(run, channels={name: every(channel) for name, channel in run.channels.items()})


def errors(study: Study, fit: Fit) -> dict[str, float]:
    """Errors over the noise by kind of run."""
    kinds = {"fitted": fit.blocks, "held out": study.held_out_blocks(fit), "exam": study.exam_blocks(fit)}
    return {kind: round(largest_error(blocks), 2) for kind, blocks in kinds.items() if blocks}


def main() -> None:
    """Print a row for each set."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=bench.DATA, help="folder with the sets")
    parser.add_argument("--sets", default=",".join(SETS))
    chosen = parser.parse_args()
    for name in chosen.sets.split(","):
        print(json.dumps(judged(name, chosen.data)), flush=True)


if __name__ == "__main__":
    main()
