"""What `next` and `excite` say of experiments and of motions: the sentence, the tables and the JSON of the contract."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fields import fields, plain

if TYPE_CHECKING:
    from armdyn.experiments.plan import Plan, Proposal
    from pipeline.motion.excitation import Excitation, Expectation
    from pipeline.trial.investigation import Investigation


def next_answer(plan: Plan | None, verdict: str, sentence: str, output: Path | None) -> dict[str, Any]:
    """JSON ``armdyn.next/1``.

    Args:
        plan: None where there is nothing to tell apart.
        verdict: of the diagnosis.
        sentence: for a person.
        output: the file with the designed motion; None where it was not written.
    """
    answer: dict[str, Any] = {"schema": "armdyn.next/1", "verdict": verdict, "sentence": sentence}
    if plan is None:
        return answer | {"rivals": [], "belief": {}, "experiments": [], "inseparable": []}
    names = [h.name for h in plan.rivals.hypotheses]
    return answer | {
        "rivals": names,
        "belief": plain(dict(zip(names, plan.belief, strict=True))),
        "experiments": [proposal_answer(p, output) for p in plan.proposals],
        "inseparable": [fields(p, "effects why") for p in plan.inseparable],
    }


def proposal_answer(proposal: Proposal, output: Path | None = None) -> dict[str, Any]:
    """One experiment."""
    e, motion = proposal.experiment, proposal.experiment.motion
    answer = fields(e, "kind what") | fields(proposal.outlook, "separation probability")
    answer["output"] = str(output) if e.kind == "motion" and output is not None else None
    if motion is not None:
        answer |= fields(motion, "seconds effort peak=", peak=dict(zip("xva", motion.peaks, strict=True)))
    return answer


def investigation_answer(found: Investigation) -> list[dict[str, Any]]:
    """``investigation`` of a trial, an entry per experiment; the first one, which SAC chose, has no `experiment`."""
    return [
        fields(stage.diagnosis, "verdict sentence")
        | fields(
            stage,
            "candidates experiment= belief gap residual",
            experiment=None if stage.proposal is None else proposal_answer(stage.proposal),
        )
        for stage in found.stages
    ]


SCHEMA = "armdyn.excite/1"
Rows = tuple[Sequence[str], list[list[str]]]
"""Header and cells."""


def sentence(found: Excitation) -> str:
    """What the motion is expected to do, beside others, in one or two sentences."""
    goal, seconds = found.goal, f"{found.trajectory.time[-1]:g} s"
    if goal.rivals:
        smallest = [None if e is None else min(e.separations) ** 0.5 for e in _contenders(found)]
        text = (
            f"{seconds} that tell {goal.rivals[0]} from {goal.rivals[1]}: whichever of both is there, at its typical "
            f"size, stands out by {_figure(smallest[0])} standard deviations at least, against"
        )
        return text + _beside(found, [None if s is None else _figure(s) for s in smallest[1:]], " {} with {}") + "."
    names = _listed([*dict.fromkeys(goal.columns.unknowns[i].effect for i in goal.wanted)])
    factors = [None if other is None else _figure(factor(found, other)) for other in (found.random, found.conditioned)]
    text = f"{seconds} that determine {names}: their standard deviations are"
    return text + _beside(found, factors, " {} times smaller than with {}") + " (geometric mean)."


def factor(found: Excitation, other: Expectation, unknowns: Sequence[int] | None = None) -> float:
    """How many times smaller the standard deviations are than those of another motion: geometric mean."""
    chosen = _determined(found) if unknowns is None else np.asarray(unknowns, dtype=int)
    if not len(chosen):
        return math.nan
    return float(np.exp(np.mean(np.log(other.std[chosen] / found.expected.std[chosen]))))


def expectation_rows(found: Excitation, most: int) -> Rows:
    """What is expected of this motion and of others, by unknown, or by effect where they are more than `most`."""
    goal = found.goal
    if goal.rivals:
        header = ["if there is", "standard deviations from the rival", "best random", "least condition number"]
        rows = []
        for k, case in enumerate(goal.hidden):
            where = f" on {case.joint}" if case.joint else ""
            values = [None if e is None else e.separations[k] ** 0.5 for e in _contenders(found)]
            rows.append([f"{case.effect}{where}", *map(_cell, values)])
        return _shown(found, header, rows)
    unknowns, determined = goal.columns.unknowns, _determined(found)
    if len(goal.wanted) > most:
        header = ["effect (mean of its unknowns)", "unknowns", "random / this", "condition number / this"]
        rows = []
        for name in dict.fromkeys(unknowns[i].effect for i in goal.wanted):
            own = [k for k in determined if unknowns[goal.wanted[k]].effect == name]
            ratios = [None if e is None else factor(found, e, own) for e in (found.random, found.conditioned)]
            rows.append([name, str(len(own)), *map(_cell, ratios)])
        return _shown(found, header, rows)
    header = ["unknown", "standard deviation", "best random", "least condition number"]
    rows = []
    for k, i in enumerate(goal.wanted):
        p = unknowns[i]
        cells = [None if e is None else float(e.std[k]) for e in _contenders(found)]
        if k not in determined:
            rows.append([p.name, "no motion tells", "", ""])
            continue
        rows.append([p.name, f"{_cell(cells[0])} {p.unit}", *map(_cell, cells[1:])])
    return _shown(found, header, rows)


def peak_rows(found: Excitation) -> Rows:
    """How far, how fast and how strongly every joint moves, with the shares of its limits."""
    header = ["joint", "from", "to", "speed", "acceleration", "torque"]
    rows = []
    for peak in peaks(found):
        cells = [f"{peak[name]['value']:.3g} ({100 * peak[name]['share']:.0f} %)" for name in header[3:]]
        rows.append([peak["joint"], f"{peak['lowest']:.3g}", f"{peak['highest']:.3g}", *cells])
    return header, rows


def peaks(found: Excitation) -> list[dict[str, Any]]:
    """By joint: the range of its positions, and its largest speed, acceleration and torque."""
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


def excitation_answer(found: Excitation, output: Path) -> dict[str, Any]:
    """JSON of `excite`."""
    goal, motion = found.goal, found.trajectory
    columns, hopeless, motions = goal.columns, set(goal.hopeless.tolist()), _contenders(found)
    return {
        "schema": SCHEMA,
        "sentence": sentence(found),
        "output": str(output),
        "robot": columns.arm.robot.name,
        "joints": list(motion.joint_names),
        "seconds": float(motion.time[-1]),
        "rate": columns.rate,
        "samples": len(motion),
        "for": list(dict.fromkeys(columns.unknowns[i].effect for i in goal.wanted)) if not goal.rivals else [],
        **fields(goal, "rivals beside taken_as_known= inseparable", taken_as_known=goal.left_out),
        "torque_noise": dict(zip(motion.joint_names, columns.noise.tolist(), strict=True)),
        "unknowns": [
            fields(columns.unknowns[i], "name unit typical determined=", determined=i not in hopeless)
            | _figures("std", [None if e is None else float(e.std[k]) for e in motions])
            for k, i in enumerate(goal.wanted.tolist())
        ],
        "separations": [
            fields(case, "effect joint= rival", joint=case.joint or None)
            | _figures("separation", [None if e is None else e.separations[k] ** 0.5 for e in motions])
            for k, case in enumerate(goal.hidden)
        ],
        "random_motions": found.tried,
        "peaks": peaks(found),
        "energy": found.energy,
        "feasible": found.check.feasible,
        "check": found.check.sentence,
        "defects": list(columns.arm.robot.defects),
    }


def _figures(name: str, values: Sequence[float | None]) -> dict[str, float | None]:
    """A figure of this motion, of the best random one and of that with the least condition number."""
    return dict(zip((name, f"random_{name}", f"condition_number_{name}"), values, strict=True))


def _contenders(found: Excitation) -> tuple[Expectation, Expectation | None, Expectation | None]:
    return found.expected, found.random, found.conditioned


def _determined(found: Excitation) -> np.ndarray:
    """Positions, among the wanted unknowns, of those that some motion determines."""
    return np.flatnonzero(~np.isin(found.goal.wanted, found.goal.hopeless))


def _beside(found: Excitation, figures: Sequence[str | None], form: str) -> str:
    """The other motions in words, each with its figure."""
    names = (f"the best of {found.tried} random motions", "the motion of the least condition number")
    return " and".join(form.format(f, n) for f, n in zip(figures, names, strict=True) if f is not None)


def _shown(found: Excitation, header: list[str], rows: list[list[str]]) -> Rows:
    """Without the column of a motion that was not asked for."""
    if found.conditioned is not None:
        return header, rows
    return header[:-1], [row[:-1] for row in rows]


def _figure(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _cell(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.3g}"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
