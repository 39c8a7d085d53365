"""Which effects does armdyn find in public recordings of real arms, and how good is it beside a fit by hand?

    python benchmarks/real_arms.py --data DIR

The recordings are not in the repository. For each set the arm as its URDF describes it is repaired with the training
runs; held-out runs take part in choosing, exams in nothing. Errors are the root of the sum of the joints' squared rms
errors, in N m (of the slide in N). By hand is the best structure that a person found by least squares on filtered
signals, with no code of armdyn, on the same exam.
"""

import time
from argparse import ArgumentParser
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import _timing as bench
import numpy as np
from _hidden_table import JOINT_EFFECTS

from armdyn.arm.model import arm_model
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.run import Run, read_run


@dataclass(frozen=True)
class Recorded:
    """Set of recordings of one arm.

    Attributes:
        folder: below the data folder.
        robot: a known one, or a URDF file in the folder.
        training: stems of the files.
        held_out: likewise.
        exam: stem of the file.
        by_hand: error in the exam; None where nobody looked.
    """

    folder: str
    robot: str
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    exam: str
    by_hand: float | None = None


SETS = (
    Recorded(
        "arm_dfki_double", "double_pendulum_C1.urdf", ("train_a", "train_b", "train_big", "train_slow"), ("heldout",),
        "heldout_fast",
    ),
    Recorded("arm_gen3", "gen3.urdf", ("train_all", "train_j1", "train_j2", "train_j3", "train_j4"), (), "heldout"),
    Recorded("arm_panda_unisa", "panda", ("train",), (), "heldout"),
    Recorded("emps", "emps.urdf", ("emps_reference",), (), "emps_pulses", 3.79),
    Recorded(
        "ur10e", "ur10e.urdf", ("ur-20_02_12-50sec_12harm", "ur-20_02_10-30sec_12harm"), ("ur-20_02_05-20sec_8harm",),
        "ur-20_02_06-20sec_5harm", 3.88,
    ),
)  # fmt: skip


def total(errors: Mapping[str, float]) -> float:
    """Root of the sum of squared errors over the joints."""
    return float(np.linalg.norm(list(errors.values())))


def examine(recorded: Recorded, data: Path) -> list[str]:
    """Row of the table for one set."""
    folder = data / recorded.folder

    def runs(*stems: str) -> list[Run]:
        return [read_run(folder / f"{stem}.csv") for stem in stems]

    file = folder / recorded.robot
    model = arm_model(file) if file.exists() else arm_model(robot=recorded.robot)
    begun = time.process_time()
    study = make_study(
        model, runs(*recorded.training), runs(*recorded.held_out), JOINT_EFFECTS, exam=runs(recorded.exam)
    )
    found = repair(study)
    seconds = time.process_time() - begun
    first, last = found.path[0], found.path[-1]
    names = ", ".join(dict.fromkeys(f"`{name}`" for step in found.path[1:] for name in step.added))
    values = sum(len(effect.names) for effect in found.steps[-1].effects)
    hand = "" if recorded.by_hand is None else f"{recorded.by_hand:.3g}"
    before, after = (f"{total(step.rmse):.3g}, {total(step.exam_rmse):.3g}" for step in (first, last))
    return [recorded.folder, names, str(values), before, after, hand, f"{seconds:.0f}"]


def main() -> None:
    """Print the table."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=bench.DATA, help="folder with the sets")
    data = parser.parse_args().data
    if not data.is_dir():
        raise SystemExit(f"{data}: there is no such folder: give --data")
    headings = ["set", "named", "values", "as given: training, exam", "repaired", "exam by hand", "processor s"]
    bench.print_table("found in recordings of real arms", headings, [examine(each, data) for each in SETS], texts=2)


if __name__ == "__main__":
    main()
