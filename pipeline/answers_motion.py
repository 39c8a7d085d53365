"""Results of the commands `next` and `excite`: sentences, numbers for tables, and JSON output."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr

from pipeline.fields import attributes_as_json, finite_or_none, json_value

if TYPE_CHECKING:
    from armdyn.experiments.plan import ExperimentPlan, ProposedExperiment
    from armdyn.experiments.recorded import ArmQuestion
    from pipeline.motion.excitation import Excitation
    from pipeline.trial.investigation import Investigation


def next_experiment_json(
    plan: ExperimentPlan | None, verdict: str, sentence: str, output: Path | None
) -> dict[str, Any]:
    """JSON output of the command `next`, ``armdyn.next/1``.

    Args:
        plan: the planned experiments; None where there are no effects to distinguish.
        verdict: verdict of the diagnosis.
        sentence: summary for a person.
        output: the file with the designed motion; None where it was not written.
    """
    answer: dict[str, Any] = {"schema": "armdyn.next/1", "verdict": verdict, "sentence": sentence}
    if plan is None:
        return answer | {"rivals": [], "belief": {}, "experiments": [], "inseparable": []}
    names = [h.name for h in plan.rivals.hypotheses]
    return answer | {
        "rivals": names,
        "belief": json_value(dict(zip(names, plan.rival_probabilities, strict=True))),
        "experiments": [
            proposed_experiment_json(p, output if _is_written(p, first=k == 0) else None)
            for k, p in enumerate(plan.proposals)
        ],
        "inseparable": [attributes_as_json(p, "effects why") for p in plan.inseparable],
    }


def proposed_experiment_json(proposal: ProposedExperiment, output: Path | None = None) -> dict[str, Any]:
    """JSON of one proposed experiment; `output` is the file with its motion or its inputs, None for no file."""
    e, motion = proposal.experiment, proposal.experiment.motion
    answer = attributes_as_json(e, "kind what") | attributes_as_json(proposal.expected, "separation probability")
    answer["output"] = None if output is None else str(output)
    if motion is not None:
        answer |= attributes_as_json(
            motion, "seconds=duration effort peak=", peak=dict(zip("xva", motion.peaks, strict=True))
        )
    return answer


def next_motion_json(asked: ArmQuestion, found: Excitation | None, output: Path | None) -> dict[str, Any]:
    """JSON output of the command `next` for an arm, ``armdyn.next/1``.

    Args:
        asked: what the recordings leave open.
        found: the designed motion; None where nothing is open.
        output: the file with the motion; None where it was not written.
    """
    answer: dict[str, Any] = {"schema": "armdyn.next/1", "verdict": asked.verdict.key, "sentence": asked.sentence}
    if found is None:
        return answer | {"rivals": [], "belief": {}, "experiments": [], "inseparable": []}
    goal, told = found.goal, set(determinable_parameter_indices(found).tolist())
    separation = float(rival_separations(found)[:, 0].min()) if goal.rivals else None
    motion = {
        "kind": "motion",
        "what": excitation_sentence(found),
        "separation": separation,
        "probability": None if separation is None else right_verdict_probability(separation),
        "output": None if output is None else str(output),
        "seconds": float(found.trajectory.time[-1]),
        "determines": [
            attributes_as_json(goal.columns.unknowns[i], "name unit") | {"std": float(std) if k in told else None}
            for k, (i, std) in enumerate(zip(goal.wanted, found.expected.std, strict=True))
        ],
    }
    pairs = [{"effects": list(goal.rivals), "why": why} for why in goal.inseparable]
    return answer | {"rivals": list(goal.rivals), "belief": {}, "experiments": [motion], "inseparable": pairs}


def _is_written(proposal: ProposedExperiment, *, first: bool) -> bool:
    """Whether `next --output` writes this experiment: the designed motion, or the best signals for a process."""
    return proposal.experiment.kind == "motion" or (first and proposal.experiment.recording is not None)


def investigation_json(found: Investigation) -> list[dict[str, Any]]:
    """JSON of the experiments that a trial made to find missing effects, one entry per experiment.

    The motion of the first experiment is chosen by Sequential Action Control (SAC); its entry `experiment` is null.
    """
    return [
        attributes_as_json(stage.diagnosis, "verdict sentence")
        | attributes_as_json(
            stage,
            "candidates experiment= belief gap residual too_small_to_show=",
            experiment=None if stage.proposal is None else proposed_experiment_json(stage.proposal),
            too_small_to_show=[
                {"parameter": one.parameter.name, "size": finite_or_none(one.size), "unit": one.parameter.unit}
                for one in stage.limits
            ],
        )
        for stage in found.stages
    ]


def right_verdict_probability(separation: float) -> float:
    """Probability that a diagnosis then finds one of two effects alone, for their separation in standard deviations.

    If the rise of chi2 without noise is s^2, noise makes it normal with a standard deviation of 2 s.
    """
    from armdyn.experiments.separation import TIE_CHI2

    return float(ndtr((separation**2 - TIE_CHI2) / (2.0 * separation))) if separation > 0.0 else 0.0


def rival_separations(found: Excitation) -> np.ndarray:
    """Expected separation of two rival effects, in standard deviations, for each of k cases: (k, 3).

    A case is one of the two effects, present on one joint. The columns are three motions: the designed one, the best
    random one, and the one with the smallest condition number.
    """
    return np.sqrt(compare_with_other_motions(found, "separations"))


def compare_with_other_motions(found: Excitation, what: str) -> np.ndarray:
    """Compare an attribute (k,) of `Expectation` for three motions: the columns of (k, 3).

    The columns are the designed motion, the best random one, and the one with the smallest condition number; nan for a
    motion that was not computed. `what` is the attribute's name.
    """
    motions = (found.expected, found.random, found.conditioned)
    own = np.asarray(getattr(found.expected, what))
    return np.column_stack([own * np.nan if motion is None else getattr(motion, what) for motion in motions])


def determinable_parameter_indices(found: Excitation) -> np.ndarray:
    """Indices, among the parameters that the user wants to determine, of those that a motion can determine."""
    return np.flatnonzero(~np.isin(found.goal.wanted, found.goal.unidentifiable))


def std_ratios_to_designed_motion(found: Excitation, chosen: Sequence[int] | np.ndarray | None = None) -> list[float]:
    """Standard deviations of parameters with two other motions, divided by those with the designed motion.

    The other motions are the best random one and the one with the smallest condition number. The ratios are geometric
    means over parameters.

    Args:
        found: the designed motion.
        chosen: indices, among the wanted parameters, of those that are averaged; by default all that can be determined.
    """
    std = compare_with_other_motions(found, "std")[determinable_parameter_indices(found) if chosen is None else chosen]
    return np.exp(np.log(std[:, 1:] / std[:, :1]).mean(axis=0)).tolist() if len(std) else [math.nan, math.nan]


def improvement_over_other_motions(found: Excitation) -> list[float]:
    """How many times better the designed motion is than each other motion.

    To determine parameters, these are the ratios of standard deviations (`std_ratios_to_designed_motion`); to
    distinguish two rival effects, the ratios of the smallest separations.
    """
    if not found.goal.rivals:
        return std_ratios_to_designed_motion(found)
    own, *others = rival_separations(found).min(axis=0).tolist()
    return [own / other for other in others]


def excitation_sentence(found: Excitation) -> str:
    """Sentence about the expected result of a designed motion, compared with other motions."""
    goal, seconds = found.goal, f"{found.trajectory.time[-1]:g} s"
    others = (f"the best of {found.random_count} random motions", "the motion of the least condition number")
    made = [name for name, motion in zip(others, (found.random, found.conditioned), strict=True) if motion is not None]
    if goal.rivals:
        own, *smallest = rival_separations(found).min(axis=0).tolist()
        beside = " and".join(f" {_short(s)} with {name}" for s, name in zip(smallest, made, strict=False))
        return (
            f"{seconds} that tell {goal.rivals[0]} from {goal.rivals[1]}: whichever of the two is present, at its "
            f"typical size, stands out by {_short(own)} standard deviations at least, against{beside}."
        )
    *names, last = dict.fromkeys(goal.columns.unknowns[i].effect for i in goal.wanted)
    listed = f"{', '.join(names)} and {last}" if names else last
    times = zip(std_ratios_to_designed_motion(found), made, strict=False)
    beside = " and".join(f" {_short(gain)} times smaller than with {name}" for gain, name in times)
    return f"{seconds} that determine {listed}: their standard deviations are{beside} (geometric mean)."


def _short(value: float) -> str:
    return "–" if not math.isfinite(value) else f"{value:.2g}" if value < 10 else f"{value:.0f}"


def joint_peaks(found: Excitation) -> list[dict[str, Any]]:
    """Position range and largest speed, acceleration and torque of each joint in a motion, with shares of the limits.

    The result has a dictionary per joint.
    """
    motion, limits = found.trajectory, found.goal.columns.arm.robot.limits
    rows = []
    for i, joint in enumerate(motion.joint_names):
        q = motion.q[:, i]
        row: dict[str, Any] = {"joint": joint, "lowest": float(q.min()), "highest": float(q.max())}
        for name, values, bound in (
            ("speed", motion.v, limits.velocity),
            ("acceleration", motion.a, limits.acceleration),
            ("torque", found.torque, limits.effort),
        ):
            value = float(np.abs(values[:, i]).max())
            row[name] = {"value": value, "share": value / float(bound[i])}
        rows.append(row)
    return rows


def excitation_json(found: Excitation, output: Path) -> dict[str, Any]:
    """JSON output of the command `excite`, ``armdyn.excite/1``; `output` is the file with the motion."""
    goal, motion, columns = found.goal, found.trajectory, found.goal.columns
    wanted = [columns.unknowns[i] for i in goal.wanted]
    hopeless = np.isin(goal.wanted, goal.unidentifiable).tolist()
    std = zip(wanted, hopeless, compare_with_other_motions(found, "std"), strict=True)
    apart = zip(goal.separations, rival_separations(found), strict=True)

    def figures(name: str, row: np.ndarray) -> dict[str, Any]:
        return dict(zip((name, f"random_{name}", f"condition_number_{name}"), json_value(row), strict=True))

    return {
        "schema": "armdyn.excite/1",
        "sentence": excitation_sentence(found),
        "output": str(output),
        "robot": columns.arm.robot.name,
        "joints": list(motion.joint_names),
        "seconds": float(motion.time[-1]),
        "rate": columns.rate,
        "samples": len(motion),
        "for": [] if goal.rivals else list(dict.fromkeys(unknown.effect for unknown in wanted)),
        **attributes_as_json(goal, "rivals beside=nuisance_effects taken_as_known=effects_taken_as_known inseparable"),
        "torque_noise": dict(zip(motion.joint_names, columns.noise.tolist(), strict=False)),
        "unknowns": [
            attributes_as_json(unknown, "name unit typical determined=", determined=not lost) | figures("std", row)
            for unknown, lost, row in std
        ],
        "separations": [
            attributes_as_json(case, "effect joint= rival", joint=case.joint or None) | figures("separation", row)
            for case, row in apart
        ],
        "times_better_than": json_value(
            dict(zip(("random", "condition_number"), improvement_over_other_motions(found), strict=True))
        ),
        "random_motions": found.random_count,
        "peaks": joint_peaks(found),
        "energy": found.energy,
        "feasible": found.feasibility.feasible,
        "check": found.feasibility.sentence,
        "defects": list(columns.arm.robot.defects),
    }
