"""What a script or notebook asks for: fit, compare, diagnose and repair a model, in one call each."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

from armdyn.effects.effect import Effect
from armdyn.effects.user import available
from armdyn.identify import compare as _compare
from armdyn.identify import diagnose as _diagnose
from armdyn.identify import repair as _repair
from armdyn.identify.study import Study
from armdyn.model import Model
from armdyn.model_file import read_model
from armdyn.run import Run, read_run
from armdyn.run_checks import check_run

AnyModel: TypeAlias = Model | str | Path
Runs: TypeAlias = Sequence[Run | str | Path]


def fit(model: AnyModel, runs: Runs) -> Model:
    """The model with the values and standard deviations that the runs give.

    Args:
        model: or its file.
        runs: recordings, or their files.

    Raises:
        InputError: something cannot be read or compared.
    """
    return _repair.add(study_of(model, runs, (), ()), ()).model


def compare(model: AnyModel, runs: Runs, held_out: Runs = (), exam: Runs = ()) -> _compare.Comparison:
    """Fit the model and see where it fails.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take no part in the fit.
        exam: recordings that take part in nothing: their error is computed at the very end.

    Raises:
        InputError: something cannot be read or compared.
    """
    return _compare.compare(study_of(model, runs, held_out, None, exam))


def diagnose(
    model: AnyModel, runs: Runs, held_out: Runs = (), effects: Iterable[Effect] | None = None
) -> _diagnose.Diagnosis:
    """Find out which effect the model lacks.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take part in choosing effects, never in a fit.
        effects: to choose from; the catalogue and the base's own where it is not given.

    Raises:
        InputError: something cannot be read or compared.
    """
    return _diagnose.diagnose(study_of(model, runs, held_out, effects))


def repair(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    exam: Runs = (),
) -> _repair.Repair:
    """Diagnose and add until nothing is left to explain.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take part in choosing effects, never in a fit.
        effects: to choose from; the catalogue and the base's own where it is not given.
        exam: recordings that take part in nothing: every step tells the error on them.

    Raises:
        InputError: something cannot be read or compared.
    """
    return _repair.repair(study_of(model, runs, held_out, effects, exam))


def study_of(model: AnyModel, runs: Runs, held_out: Runs, effects: Iterable[Effect] | None, exam: Runs = ()) -> Study:
    """A model against recordings, each given as it is or as its file; see `repair`."""
    known = model if isinstance(model, Model) else read_model(model)
    training, others, last = (
        [run if isinstance(run, Run) else read_run(run) for run in given] for given in (runs, held_out, exam)
    )
    for run in (*training, *others, *last):
        check_run(known, run)
    return Study(known, training, others, available(known) if effects is None else tuple(effects), last)
