"""The goal of a motion: unknowns to determine, or rival effects to distinguish."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.effects.catalogue import find
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, TaskFailedError
from armdyn.experiments.columns import Columns, present
from armdyn.experiments.criteria import Conditioned, Criterion, DOptimality, RivalSeparation, Separated
from armdyn.experiments.structure import Structure
from armdyn.threads import one_thread

USUAL_EFFECTS = ("joint_viscous_friction", "joint_coulomb_friction", "torque_offset", "rotor_inertia", "link_inertia")
"""Effects that every arm may have: nuisance beside the wanted ones, or wanted themselves where none is named."""


@dataclass(frozen=True, eq=False)
class Goal:
    """The goal of a motion.

    Attributes:
        columns: regressor of all unknowns.
        criterion: function to minimise.
        wanted: indices of the unknowns to determine; with rivals, those of the rivals.
        hopeless: indices of wanted unknowns that no motion identifies, because others make the same torques.
        beside: names of the nuisance effects.
        left_out: names of usual effects that are treated as known, with the reason.
        rivals: names of two effects to distinguish; empty where unknowns are to be determined.
        hidden: with rivals, the effects that may be the true one.
        inseparable: sentences on what no motion can distinguish.
    """

    columns: Columns
    criterion: Criterion
    wanted: np.ndarray
    hopeless: np.ndarray
    beside: tuple[str, ...]
    left_out: Mapping[str, str]
    rivals: tuple[str, ...] = ()
    hidden: tuple[RivalSeparation, ...] = ()
    inseparable: tuple[str, ...] = ()
    structure: Structure = field(repr=False, kw_only=True)

    @property
    def conditioned(self) -> Criterion:
        """The common criterion (condition number) for the same unknowns."""
        return Conditioned(self.structure.independent(), self.columns.typical)


@one_thread
def determining(model: ArmModel, wanted: Sequence[Effect], rate: float) -> Goal:
    """Build the goal to determine the unknowns of effects; those of `USUAL_EFFECTS` where none is given.

    Args:
        model: the arm as described, without effects.
        wanted: effects, on some joints or on all on which they can act.
        rate: sampling rate of the recording, Hz.

    Raises:
        InputError: an effect cannot act on this arm or its joints, or no motion can be designed for it.
    """
    effects = list(wanted) or [find(name) for name in USUAL_EFFECTS if model.reachable(find(name))]
    columns = _columns(model, effects, USUAL_EFFECTS, rate)
    own = _indices(columns, effects)
    structure = Structure.of(columns)
    alone = structure.hopeless(own, np.zeros(0, dtype=int))
    beside: list[str] = []
    left_out: dict[str, str] = {}
    for name in USUAL_EFFECTS:
        others = np.setdiff1d(np.concatenate([columns.of(e) for e in (*beside, name)]), own)
        if not len(np.setdiff1d(columns.of(name), own)):
            continue
        lost = np.setdiff1d(structure.hopeless(own, others), alone)
        if len(lost):
            left_out[name] = f"no motion could tell it from {columns.unknowns[lost[0]].name}"
        else:
            beside.append(name)
    columns = _columns(model, effects, beside, rate)
    structure, own = Structure.of(columns), _indices(columns, effects)
    return Goal(
        columns, DOptimality(own, columns.prior), own, structure.hopeless(own, np.zeros(0, dtype=int)), tuple(beside),
        left_out, structure=structure,
    )  # fmt: skip


@one_thread
def separating(model: ArmModel, first: Effect, second: Effect, rate: float) -> Goal:
    """Build the goal to distinguish two effects, whichever of them is present.

    Args:
        model: the arm as described, without effects.
        first: an effect, on some joints or on all on which it can act.
        second: the other effect.
        rate: sampling rate of the recording, Hz.

    Raises:
        InputError: an effect cannot act on this arm or its joints, or no motion can be designed for it.
        TaskFailedError: no motion can distinguish them.
    """
    if first.name == second.name:
        raise InputError(f"--rivals {first.name},{second.name}: name two different effects")
    pair = (first, second)
    columns = _columns(model, pair, USUAL_EFFECTS, rate)
    structure = Structure.of(columns)
    beside: list[str] = []
    left_out: dict[str, str] = {}
    cases = _cases(columns, structure, pair, [])
    for name in USUAL_EFFECTS:
        if name in (first.name, second.name) or not len(columns.of(name)):
            continue
        narrowed = _cases(columns, structure, pair, [*beside, name])
        if any(n.directions.shape[1] < c.directions.shape[1] for n, c in zip(narrowed, cases, strict=True)):
            left_out[name] = "with it no motion could tell some of their changes apart"
        else:
            beside.append(name)
    columns = _columns(model, pair, beside, rate)
    structure, own = Structure.of(columns), _indices(columns, pair)
    cases = _cases(columns, structure, pair, beside)
    hidden = tuple(case for case in cases if case.directions.shape[1])
    inseparable = tuple(
        f"{case.effect}{f' on {case.joint}' if case.joint else ''} makes torques that {case.rival} makes as well"
        for case in cases
        if not case.directions.shape[1]
    )
    if not hidden:
        raise TaskFailedError(f"no motion can tell {first.name} from {second.name}: {inseparable[0]}")
    return Goal(
        columns, Separated(hidden, columns.prior), own, structure.hopeless(own, np.zeros(0, dtype=int)), tuple(beside),
        left_out, (first.name, second.name), hidden, inseparable, structure=structure,
    )  # fmt: skip


def _columns(model: ArmModel, effects: Sequence[Effect], beside: Sequence[str], rate: float) -> Columns:
    """Regressor of wanted effects, and of nuisance effects on all joints on which they can act."""
    for effect in effects:
        model = model.with_effect(effect)
    for effect in map(find, beside):
        if model.reachable(effect) and model.lacks(effect):
            model = model.with_effect(effect)
    return Columns(present(model), rate)


def _indices(columns: Columns, effects: Sequence[Effect]) -> np.ndarray:
    """Column indices of the unknowns of these effects, on their joints."""
    found = [columns.of(e.name, joint) for e in effects for joint in e.joints or columns.model.joints_with(e.name)]
    return np.unique(np.concatenate(found))


def _cases(
    columns: Columns, structure: Structure, pair: tuple[Effect, Effect], beside: Sequence[str]
) -> tuple[RivalSeparation, ...]:
    """Each effect on each of its joints, against the other effect on all of its joints."""
    found = []
    for truth, rival in (pair, pair[::-1]):
        nuisance = [columns.of(name) for name in beside]
        fitted = np.unique(np.concatenate([_indices(columns, [rival]), *nuisance]))
        for joint in truth.joints or columns.model.joints_with(truth.name):
            own = columns.of(truth.name, joint)
            directions = structure.distinguishable(own, np.setdiff1d(fitted, own))
            found.append(RivalSeparation(truth.name, joint, rival.name, own, np.setdiff1d(fitted, own), directions))
    return tuple(found)
