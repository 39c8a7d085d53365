"""The answer of `armdyn next` in the form of the contract."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from armdyn.experiments.plan import Plan, Proposal
from pipeline.answers import number

if TYPE_CHECKING:
    from pipeline.trial.investigation import Investigation


def next_answer(plan: Plan | None, verdict: str, sentence: str, output: Path | None) -> dict[str, Any]:
    """JSON ``armdyn.next/1``.

    Args:
        plan: None where there is nothing to tell apart.
        verdict: of the diagnosis.
        sentence: for a person.
        output: the file with the designed motion; None where it was not written.
    """
    return {
        "schema": "armdyn.next/1",
        "verdict": verdict,
        "sentence": sentence,
        "rivals": [h.name for h in plan.rivals.hypotheses] if plan else [],
        "belief": {h.name: number(b) for h, b in zip(plan.rivals.hypotheses, plan.belief, strict=True)} if plan else {},
        "experiments": [proposal_answer(p, output) for p in plan.proposals] if plan else [],
        "inseparable": [{"effects": list(p.effects), "why": p.why} for p in plan.inseparable] if plan else [],
    }


def proposal_answer(proposal: Proposal, output: Path | None = None) -> dict[str, Any]:
    """One experiment."""
    e, motion = proposal.experiment, proposal.experiment.motion
    answer: dict[str, Any] = {
        "kind": e.kind,
        "what": e.what,
        "separation": number(proposal.outlook.separation),
        "probability": number(proposal.outlook.probability),
        "output": str(output) if e.kind == "motion" and output is not None else None,
    }
    if motion is not None:
        x, v, a = motion.peaks
        answer |= {"seconds": motion.seconds, "effort": motion.effort, "peak": {"x": x, "v": v, "a": a}}
    return answer


def investigation_answer(found: "Investigation") -> list[dict[str, Any]]:
    """``investigation`` of a trial, an entry per experiment; the first one, which SAC chose, has no `experiment`."""
    return [
        {
            "verdict": stage.diagnosis.verdict.key,
            "sentence": stage.diagnosis.sentence,
            "candidates": list(stage.candidates),
            "experiment": None if stage.proposal is None else proposal_answer(stage.proposal),
            "belief": {name: number(share) for name, share in stage.belief.items()},
            "gap": number(stage.gap),
            "residual": number(stage.residual),
        }
        for stage in found.stages
    ]
