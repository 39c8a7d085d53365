"""The goal of a designed motion of an arm: unknowns to determine, or rival effects to distinguish."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.slots import ARMATURE, DAMPING, FRICTION, LINK, OFFSET, simplest_effect
from armdyn.effects.catalogue import find
from armdyn.effects.effect import Effect
from armdyn.effects.wrench import wrench_offset
from armdyn.errors import InputError, TaskFailedError
from armdyn.experiments.columns import EarlierRuns, TorqueRegressor, with_all_parameters_active
from armdyn.experiments.criteria import (
    InformationCriterion,
    RivalSeparation,
    d_optimality,
    log_condition,
    log_harmonic_separation,
)
from armdyn.experiments.structure import (
    distinguishable_changes,
    independent_columns,
    regressor_at_random_states,
    unidentifiable_unknowns,
)
from armdyn.threads import one_thread

USUAL_EFFECTS = tuple(simplest_effect(slot).name for slot in (DAMPING, FRICTION, OFFSET, ARMATURE, LINK))
"""Effects that every arm may have: nuisance effects, or the wanted ones if none is named."""

NO_INDICES = np.zeros(0, dtype=int)


@dataclass(frozen=True, eq=False)
class MotionGoal:
    """The goal of a designed motion: which unknowns it determines, or which effects it distinguishes.

    Attributes:
        columns: regressor of all unknowns.
        criterion: function of the information matrix that the motion minimises.
        wanted: indices of the unknowns to determine; with rivals, those of the rivals.
        unidentifiable: indices of wanted unknowns that no motion identifies, because others make the same torques.
        nuisance_effects: names of the effects that are fitted together with the wanted ones.
        effects_taken_as_known: names of usual effects that are treated as known, with the reason.
        rivals: names of two effects to distinguish; empty where unknowns are to be determined.
        separations: for rivals, each effect on each joint that may be the true one.
        inseparable: sentences on effects that no motion can distinguish.
        random_state_rows: (N, P) regressor at random states of the arm.
    """

    columns: TorqueRegressor
    criterion: InformationCriterion
    wanted: np.ndarray
    unidentifiable: np.ndarray
    nuisance_effects: tuple[str, ...]
    effects_taken_as_known: Mapping[str, str]
    rivals: tuple[str, ...] = ()
    separations: tuple[RivalSeparation, ...] = ()
    inseparable: tuple[str, ...] = ()
    random_state_rows: np.ndarray = field(repr=False, kw_only=True)

    @property
    def condition_number_criterion(self) -> InformationCriterion:
        """The criterion of the condition number, for the unknowns of this goal."""
        return partial(
            log_condition, typical=self.columns.typical, independent=independent_columns(self.random_state_rows)
        )


def usual_effects(model: ArmModel) -> tuple[str, ...]:
    """Names of the effects that an arm may have, and its force/torque sensors: none is without offsets."""
    return (*USUAL_EFFECTS, *((wrench_offset.name,) if model.sensors else ()))


@one_thread
def goal_to_determine(
    model: ArmModel, wanted: Sequence[Effect], rate: float, earlier: EarlierRuns | None = None
) -> MotionGoal:
    """The goal to determine the unknowns of effects, by default of `USUAL_EFFECTS`.

    `rate` is the sampling rate of the recording, Hz; `earlier` are recordings that there are already.

    Raises:
        InputError: an effect cannot act on this arm or its joints, or no motion can be designed for it.
    """
    effects = list(wanted) or [find(name) for name in USUAL_EFFECTS if model.joints_effect_can_act_on(find(name))]
    usual = usual_effects(model)
    columns = _columns(model, effects, usual, rate, earlier)
    rows, own = regressor_at_random_states(columns), _indices(columns, effects)
    shown = np.flatnonzero(rows.any(axis=0))
    alone = unidentifiable_unknowns(rows, own, NO_INDICES)

    def confused(beside: Sequence[str]) -> str | None:
        others = np.setdiff1d(np.concatenate([columns.column_indices(name) for name in beside]), own)
        lost = np.setdiff1d(unidentifiable_unknowns(rows, own, others), alone)
        return f"no motion could tell it from {columns.unknowns[lost[0]].name}" if len(lost) else None

    usual = tuple(n for n in usual if len(np.setdiff1d(np.intersect1d(columns.column_indices(n), shown), own)))
    beside, left_out = _nuisance(usual, confused)
    columns = _columns(model, effects, beside, rate, earlier)
    rows, own = regressor_at_random_states(columns), _indices(columns, effects)
    criterion = partial(d_optimality, prior=columns.prior, wanted=own)
    return MotionGoal(
        columns,
        criterion,
        own,
        unidentifiable_unknowns(rows, own, NO_INDICES),
        beside,
        left_out,
        random_state_rows=rows,
    )


@one_thread
def goal_to_separate(
    model: ArmModel, first: Effect, second: Effect, rate: float, earlier: EarlierRuns | None = None
) -> MotionGoal:
    """The goal to distinguish two effects, one of which is present.

    `rate` is the sampling rate of the recording, Hz. Beside recordings that there are already, all effects that the
    model has are fitted anew.

    Raises:
        InputError: an effect cannot act on this arm or its joints, or no motion can be designed for it.
        TaskFailedError: no motion can distinguish them.
    """
    if first.name == second.name:
        raise InputError(f"--rivals {first.name},{second.name}: name two different effects")
    pair, names = (first, second), (first.name, second.name)
    own_effects = () if earlier is None else tuple(effect.name for effect in model.effects)
    possible = tuple(dict.fromkeys((*own_effects, *usual_effects(model))))
    columns = _columns(model, pair, possible, rate, earlier)
    rows = regressor_at_random_states(columns)

    def ranks(beside: Sequence[str]) -> list[int]:
        return [case.directions.shape[1] for case in _cases(columns, rows, pair, beside)]

    def confused(beside: Sequence[str]) -> str | None:
        fewer = np.less(ranks(beside), at_best).any()
        return "with it no motion could tell some of their changes apart" if fewer else None

    at_best = ranks(())
    shown = np.flatnonzero(rows.any(axis=0))
    usual = [n for n in possible if n not in names and len(np.intersect1d(columns.column_indices(n), shown))]
    beside, left_out = _nuisance(usual, confused)
    columns = _columns(model, pair, beside, rate, earlier)
    rows, own = regressor_at_random_states(columns), _indices(columns, pair)
    cases = _cases(columns, rows, pair, beside)
    hidden = tuple(case for case in cases if case.directions.shape[1])
    inseparable = tuple(
        f"{case.effect}{f' on {case.joint}' if case.joint else ''} makes torques that {case.rival} makes as well"
        for case in cases
        if not case.directions.shape[1]
    )
    if not hidden:
        raise TaskFailedError(f"no motion can tell {first.name} from {second.name}: {inseparable[0]}")
    criterion = partial(log_harmonic_separation, prior=columns.prior, cases=hidden)
    lost = unidentifiable_unknowns(rows, own, NO_INDICES)
    return MotionGoal(
        columns, criterion, own, lost, beside, left_out, names, hidden, inseparable, random_state_rows=rows
    )


def _nuisance(
    names: Sequence[str], confused: Callable[[Sequence[str]], str | None]
) -> tuple[tuple[str, ...], dict[str, str]]:
    """The effects that can be fitted beside the wanted ones, and why the others are treated as known."""
    beside: tuple[str, ...] = ()
    left_out: dict[str, str] = {}
    for name in names:
        reason = confused((*beside, name))
        if reason is None:
            beside = (*beside, name)
        else:
            left_out[name] = reason
    return beside, left_out


def _columns(
    model: ArmModel, effects: Sequence[Effect], beside: Sequence[str], rate: float, earlier: EarlierRuns | None
) -> TorqueRegressor:
    """Regressor of wanted effects, and of nuisance effects on all joints on which they can act."""
    for effect in effects:
        if all(own.name != effect.name for own in model.effects):
            model = model.with_effect(effect)
    for effect in map(find, beside):
        if model.joints_effect_can_act_on(effect) and model.can_add_effect(effect):
            model = model.with_effect(effect)
    return TorqueRegressor(with_all_parameters_active(model), rate, earlier)


def _indices(columns: TorqueRegressor, effects: Sequence[Effect]) -> np.ndarray:
    """Column indices of the unknowns of these effects, on their joints."""
    found = [
        columns.column_indices(e.name, joint)
        for e in effects
        for joint in e.joints or columns.model.joints_having_effect(e.name)
    ]
    return np.unique(np.concatenate(found))


def _cases(
    columns: TorqueRegressor, rows: np.ndarray, pair: tuple[Effect, Effect], beside: Sequence[str]
) -> tuple[RivalSeparation, ...]:
    """Each effect on each of its joints, against the other effect on all of its joints."""
    found = []
    for truth, rival in (pair, pair[::-1]):
        every = np.concatenate([_indices(columns, [rival]), *(columns.column_indices(name) for name in beside)])
        for joint in truth.joints or columns.model.joints_having_effect(truth.name):
            own = columns.column_indices(truth.name, joint)
            fitted = np.setdiff1d(every, own)
            directions = distinguishable_changes(rows, own, fitted)
            found.append(RivalSeparation(truth.name, joint, rival.name, own, fitted, directions))
    return tuple(found)
