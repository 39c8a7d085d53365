"""What a script or notebook asks for: inspect, fit, compare, diagnose and repair, in one call each."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias, TypeVar

from armdyn.discovery.discover import discover as _discover
from armdyn.discovery.result import Discovery
from armdyn.effects.effect import Effect
from armdyn.effects.user import available
from armdyn.identify import compare as _compare
from armdyn.identify import diagnose as _diagnose
from armdyn.identify import repair as _repair
from armdyn.identify.study import Study
from armdyn.inspection.check import Inspection
from armdyn.inspection.inspect import inspected, require_usable
from armdyn.inspection.plausible import compared_model, require_plausible
from armdyn.model import Model
from armdyn.model_file import read_model
from armdyn.run import Run, read_run
from armdyn.run_checks import check_run

AnyModel: TypeAlias = Model | str | Path
Answer = TypeVar("Answer")
Runs: TypeAlias = Sequence[Run | str | Path]


def fit(model: AnyModel, runs: Runs, *, trust_data: bool = False) -> Model:
    """The model with the values and standard deviations that the runs give.

    Args:
        model: or its file.
        runs: recordings, or their files.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared.
        WrongRecordingError: see `inspect`.
    """
    return _repair.add(study_of(model, runs, (), (), trust_data=trust_data), ()).model


def inspect(runs: Runs, model: AnyModel | None = None) -> Inspection:
    """Ask whether recordings are what they say they are: units, signs, columns, clocks, gaps.

    Args:
        runs: recordings, or their files.
        model: of what was recorded, or its file; without one only the signals themselves are looked at.

    Raises:
        InputError: something cannot be read.
    """
    known = model if model is None or isinstance(model, Model) else read_model(model)
    return inspected([r if isinstance(r, Run) else read_run(r) for r in runs], known)


def compare(
    model: AnyModel, runs: Runs, held_out: Runs = (), exam: Runs = (), *, trust_data: bool = False
) -> _compare.Comparison:
    """Fit the model and see where it fails.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take no part in the fit.
        exam: recordings that take part in nothing: their error is computed at the very end.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared.
        WrongRecordingError: see `inspect`.
    """
    study = study_of(model, runs, held_out, (), exam, trust_data)
    found = _compare.compare(study)
    return _plausible(study, compared_model(study.model, found), found, trust_data)


def diagnose(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    *,
    trust_data: bool = False,
) -> _diagnose.Diagnosis:
    """Find out which effect the model lacks.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take part in choosing effects, never in a fit.
        effects: to choose from; the catalogue and the base's own where it is not given.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared.
        WrongRecordingError: see `inspect`.
    """
    study = study_of(model, runs, held_out, effects, trust_data=trust_data)
    found = _diagnose.diagnose(study)
    return _plausible(study, _repair.fitted_model(study, found.search.last), found, trust_data)


def repair(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    exam: Runs = (),
    *,
    trust_data: bool = False,
) -> _repair.Repair:
    """Diagnose and add until nothing is left to explain.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take part in choosing effects, never in a fit.
        effects: to choose from; the catalogue and the base's own where it is not given.
        exam: recordings that take part in nothing: every step tells the error on them.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared.
        WrongRecordingError: see `inspect`.
    """
    study = study_of(model, runs, held_out, effects, exam, trust_data)
    found = _repair.repair(study)
    return _plausible(study, found.model, found, trust_data)


def discover(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    *,
    trust_data: bool = False,
) -> Discovery:
    """Find a formula for the force that the model lacks; `Discovery.write` makes a file of effects of it.

    Args:
        model: or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that take part in choosing the formula, never in a fit.
        effects: that are known already; the catalogue and the base's own where it is not given.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared, or there are no terms for such a model.
        WrongRecordingError: see `inspect`.
    """
    study = study_of(model, runs, held_out, effects, trust_data=trust_data)
    known = available(study.model) if effects is None else tuple(effects)
    return _discover(study.model, study.runs, study.held_out, known)


def _plausible(study: Study, model: Model, found: Answer, trust_data: bool) -> Answer:
    """An answer, unless nothing can have the values of its model."""
    if not trust_data:
        require_plausible(model, study.runs, study.model)
    return found


def study_of(
    model: AnyModel,
    runs: Runs,
    held_out: Runs,
    effects: Iterable[Effect] | None,
    exam: Runs = (),
    trust_data: bool = False,
) -> Study:
    """A model against recordings, each given as it is or as its file; see `repair`."""
    known = model if isinstance(model, Model) else read_model(model)
    training, others, last = (
        [run if isinstance(run, Run) else read_run(run) for run in given] for given in (runs, held_out, exam)
    )
    for run in (*training, *others, *last):
        check_run(known, run)
    if not trust_data:
        require_usable(inspected([*training, *others, *last], known))
    return Study(known, training, others, available(known) if effects is None else tuple(effects), last)
