"""What a script or notebook asks for: inspect, fit, compare, diagnose, add and repair, in one call each."""

from collections.abc import Iterable
from dataclasses import replace

from armdyn.checked_study import AnyModel, CheckedStudy, ModelWithCatalogue, Runs, read_runs
from armdyn.discovery.result import Discovery
from armdyn.effects.catalogue import find_several
from armdyn.effects.effect import Effect
from armdyn.identify import repair as repairs
from armdyn.identify.compare import Comparison
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.repair import Repair, require_found
from armdyn.inspection.check import Inspection
from armdyn.inspection.inspect import inspected
from armdyn.model import Model


def fit(model: AnyModel, runs: Runs, *, trust_data: bool = False) -> Model:
    """The model with the values and standard deviations that the runs give.

    Args:
        model: or its file.
        runs: recordings, or their files.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared.
        WrongRecordingError: see `inspect`.
        TaskFailedError: the fit is lost.
    """
    return require_found(repairs.add(CheckedStudy.of(model, runs, effects=(), trusted=trust_data).study, ())).model


def inspect(runs: Runs, model: AnyModel | None = None) -> Inspection:
    """Ask whether recordings are what they say they are: units, signs, columns, clocks, gaps.

    Args:
        runs: recordings, or their files.
        model: of what was recorded, or its file; without one only the signals themselves are looked at.

    Raises:
        InputError: something cannot be read.
    """
    read = read_runs(runs)
    return inspected(read) if model is None else ModelWithCatalogue.of(model).inspect(read)


def compare(
    model: AnyModel, runs: Runs, held_out: Runs = (), exam: Runs = (), *, trust_data: bool = False
) -> Comparison:
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
    return CheckedStudy.of(model, runs, held_out, exam, effects=(), trusted=trust_data).compare()


def diagnose(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    *,
    trust_data: bool = False,
) -> Diagnosis:
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
    return CheckedStudy.of(model, runs, held_out, effects=effects, trusted=trust_data).diagnose()


def add(
    model: AnyModel,
    effects: str | Effect | Iterable[str | Effect],
    runs: Runs,
    held_out: Runs = (),
    exam: Runs = (),
    *,
    trust_data: bool = False,
) -> Repair:
    """Add effects to a model, one after the other, whether or not the recordings ask for them, and refit.

    Args:
        model: or its file.
        effects: one or several, or their names, such as ``"rotor_inertia+joint_spring:elbow,wrist"``.
        runs: recordings to fit, or their files.
        held_out: recordings that take no part in a fit: every step tells the error on them.
        exam: recordings that take part in nothing: likewise.
        trust_data: go on where recordings are not what they say they are.

    Raises:
        InputError: something cannot be read or compared, or an effect is not for such a model.
        UnknownNameError: there is no such effect.
        WrongRecordingError: see `inspect`.
    """
    known = ModelWithCatalogue.of(model)
    each = [effects] if isinstance(effects, str | Effect) else effects
    wanted = [one for e in each for one in ((e,) if isinstance(e, Effect) else find_several(e, known.catalogue))]
    known = replace(known, catalogue=tuple({e.name: e.on() for e in (*known.catalogue, *wanted)}.values()))
    adding = "+".join(e.name for e in wanted)
    return CheckedStudy.of(known, runs, held_out, exam, adding=adding, trusted=trust_data).add(wanted)


def repair(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    exam: Runs = (),
    *,
    trust_data: bool = False,
) -> Repair:
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
    return CheckedStudy.of(model, runs, held_out, exam, effects=effects, trusted=trust_data).repair()


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
    return CheckedStudy.of(model, runs, held_out, effects=effects, trusted=trust_data).discover()
