"""Exam runs: nothing looks at them until the end, so that nothing was chosen in their favour.

Held-out runs take part in choosing which effects are added; their error therefore flatters the model a little. An exam
run takes part in nothing: no fit, no noise, no name and no choice depends on it.
"""

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

from armdyn.identify.prepare import check_distinct, check_distinct_data, ready
from armdyn.model import Model
from armdyn.run import Run


class Judge(Enum):
    """Runs that an error belongs to; the value says what part they took."""

    EXAM = "exam: runs that took part in nothing, neither in a fit nor in choosing"
    HELD_OUT = "held out: runs that took part in choosing the effects, and in no fit"
    IN_TURN = "held out: each run predicted from the others; these errors took part in choosing the effects"
    TRAINING = "a single run: nothing was held out"


def judges(held_out: Sequence[Run], exam: Sequence[Run], runs: Sequence[Run]) -> tuple[Judge, ...]:
    """Who judged the model besides the runs that it was fitted to, the most independent first."""
    others = Judge.HELD_OUT if held_out else Judge.IN_TURN if len(runs) > 1 else Judge.TRAINING
    return (Judge.EXAM, others) if exam else (others,)


def prepared_exam(
    model: Model, runs: Sequence[Run], held_out: Sequence[Run], exam: Sequence[Run], taken: Sequence[str]
) -> list[Run]:
    """Exam runs, checked and thinned, each under a name of its own.

    Args:
        model: which they will be held against.
        runs: for training, as given.
        held_out: likewise.
        exam: likewise.
        taken: names of the prepared training and held-out runs, which stay as they are.

    Raises:
        InputError: an exam run is a training or held-out run, or a copy of one, or cannot be used.
    """
    check_distinct({"a training run": runs, "a held-out run": held_out, "an exam run": exam})
    check_distinct_data(model, [*runs, *held_out, *exam])
    names = set(taken)
    result: list[Run] = []
    for i, run in enumerate(exam):
        name = run.name if run.name not in names else f"exam/{run.name}"
        name = name if name not in names else f"exam {i + 1}/{run.name}"
        names.add(name)
        result += model.start.pieces(ready(model, replace(run, name=name)))
    return result
