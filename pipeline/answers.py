"""Answers of compare, diagnose, repair and add in the form of the contract."""

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from armdyn.channels import FloatArray
from armdyn.faults import outliers_of
from armdyn.identify.compare import Comparison, Correction, FittedParameter
from armdyn.identify.contribution import contribution
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.explained import RepairStep
from armdyn.identify.localise import Place
from armdyn.identify.missing_force import ForceCurve
from armdyn.identify.problem import Problem
from armdyn.identify.repair import Repair
from armdyn.identify.study import Study
from armdyn.identify.suspects import Suspect
from armdyn.identify.unknown import Unknown
from armdyn.preparation import of_all_runs

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange


def comparison_answer(study: Study, found: Comparison) -> dict[str, Any]:
    """JSON of `compare`."""
    return {
        "schema": "armdyn.comparison/1",
        "model": model_answer(study),
        "explained": found.explained,
        "sentence": found.sentence,
        **fit_answer(found),
        "correction": _correction(found.correction),
        "missing_force": missing_force_answer(found.missing_force),
    }


def diagnosis_answer(study: Study, found: Diagnosis) -> dict[str, Any]:
    """JSON of `diagnose`."""
    return {
        "schema": "armdyn.diagnosis/1",
        "model": model_answer(study),
        "verdict": found.verdict.key,
        "sentence": found.sentence,
        **fit_answer(found.comparison),
        "candidates": [_suspect(suspect) for suspect in found.suspects],
        "remedies": list(found.remedies),
        "cannot_be_seen": {name: list(imitators) for name, imitators in found.unseen.items()},
        "unknown": unknown_answer(found.unknown),
        "missing_force": missing_force_answer(found.missing_force),
    }


def repair_answer(found: Repair) -> dict[str, Any]:
    """JSON of `repair` and `add`."""
    return {
        "schema": "armdyn.repair/1",
        "verdict": found.verdict.key,
        "sentence": found.sentence,
        "explained": number(found.explained),
        "effects": [effect.name for effect in found.model.effects],
        **fit_answer(found.after),
        "steps": [step_answer(step) for step in found.path],
        "links": [link_answer(link) for link in found.links],
        "unknown": unknown_answer(found.unknown),
        "missing_force": missing_force_answer(found.missing_force),
    }


def history_entries(study: Study, found: Repair) -> list[dict[str, Any]]:
    """What the model file keeps of each step of a repair.

    `contribution` is the rms, by channel, of what the step's effects do in the repaired model.
    """
    names = {"runs": [run.name for run in study.runs], "held_out": [run.name for run in study.held_out]}
    if study.exam:
        names["exam"] = [run.name for run in study.exam]
    return [
        {
            "added": _one_or_list(step.added),
            "joints": list(step.joints) or None,
            **names,
            "rmse": errors(step.rmse),
            "held_out_rmse": errors(step.held_out_rmse) or None,
            "exam_rmse": errors(step.exam_rmse) or None,
            "chi2_per_sample": number(step.chi2_per_sample),
            "bic": number(step.bic),
            "contribution": errors(contribution(found.steps[-1].fit, step.added)),
            "as_given_rmse": errors(found.path[0].rmse) if k == 0 else None,
        }
        for k, step in enumerate(found.path[1:])
    ]


def link_answer(link: "LinkChange") -> dict[str, Any]:
    """A link in kg, m and kg m^2, beside the URDF's values."""
    quantities = {
        q.name: {
            "unit": q.unit,
            "urdf": number(q.described),
            "value": number(q.value),
            "std": number(q.std),
            "determined": q.determined,
        }
        for q in link.quantities
    }
    return {"joint": link.joint, **quantities, "physical": link.physical, "warning": link.warning or None}


def model_answer(study: Study) -> dict[str, Any]:
    """Base and effects of the model as given."""
    return {"base": study.model.base, "effects": [effect.name for effect in study.model.effects if not effect.wrong]}


def fit_answer(found: Comparison) -> dict[str, Any]:
    """Parameters, channels and places of one fit."""
    return {
        "parameters": parameters_answer(found.parameters),
        "intervals_hold": found.intervals_hold,
        "std_widened_by": number(found.widened),
        "at_bound": list(found.at_bound),
        "not_determined": list(found.undetermined),
        "left_out": list(found.left_out),
        "outliers": outliers_of(found.fit.problem.runs),
        "channels": {
            name: {
                "unit": c.unit,
                "noise_std": number(c.noise_std),
                "rmse": number(c.rmse),
                "held_out_rmse": number(c.held_out_rmse),
                "exam_rmse": number(c.exam_rmse),
                "chi2_per_sample": number(c.chi2_per_sample),
                "whiteness_p_value": number(c.white),
            }
            for name, c in found.channels.items()
        },
        "preparation": preparation_answer(found.fit.problem),
        "behaves_like_dynamics": number(found.process_error),
        "where": [_place(place) for place in found.places],
    }


def missing_force_answer(curves: Iterable[ForceCurve]) -> list[dict[str, Any]]:
    """What a model cannot explain, a curve for each run, joint and quantity that it may depend on."""
    return [
        {
            "run": curve.run,
            "joint": curve.joint,
            "unit": curve.unit,
            "against": curve.against,
            "x": _row(curve.x),
            "as_given": _row(curve.as_given),
            "std": _row(curve.std),
            "repaired": None if curve.repaired is None else _row(curve.repaired),
        }
        for curve in curves
    ]


def _row(values: FloatArray) -> list[float | None]:
    """Six digits: more than any band is narrow."""
    return [number(float(f"{value:.6g}")) for value in values]


def preparation_answer(problem: Problem) -> dict[str, Any]:
    """Per channel which part of the training runs was compared; empty where nothing was filtered."""
    return {
        name: {
            "cutoff_hz": number(done.cutoff),
            "position_cutoff_hz": number(done.position_cutoff),
            "rate_hz": number(done.rate),
            "samples": done.samples,
            "recorded_rate_hz": number(done.recorded_rate),
            "recorded": done.recorded,
            "left_out": number(done.left_out),
        }
        for name, done in of_all_runs(run.preparations for run in problem.runs).items()
    }


def parameters_answer(parameters: Mapping[str, FittedParameter]) -> dict[str, Any]:
    """Values, standard deviations and units by name."""
    return {
        name: {"value": number(p.value), "std": number(p.std), "unit": p.unit, "fitted": p.fitted}
        for name, p in parameters.items()
    }


def step_answer(step: RepairStep) -> dict[str, Any]:
    """One step of the repair path."""
    return {
        "added": _one_or_list(step.added),
        "joints": list(step.joints),
        "removed": [],  # the format knows it; a repair only adds
        "tied_with": list(step.tied_with),
        "rmse": errors(step.rmse),
        "held_out_rmse": errors(step.held_out_rmse),
        "exam_rmse": errors(step.exam_rmse),
        "chi2_per_sample": number(step.chi2_per_sample),
        "bic": number(step.bic),
    }


def unknown_answer(found: Unknown | None) -> dict[str, Any] | None:
    """What is known of an effect outside the catalogue."""
    if found is None:
        return None
    return {
        "sentence": found.sentence,
        "behaves_like_dynamics": number(found.process_error),
        "terms": [{"channel": t.channel, "expression": t.expression, "share": number(t.share)} for t in found.terms],
        "frequencies": [
            {"channel": t.channel, "frequency": number(t.frequency), "amplitude": number(t.amplitude), "unit": t.unit}
            for t in found.peaks
        ],
    }


def errors(by_channel: Mapping[str, float]) -> dict[str, float | None]:
    """Errors by channel."""
    return {name: number(value) for name, value in by_channel.items()}


def number(value: float | None) -> float | None:
    """A finite float, or null."""
    return float(value) if value is not None and math.isfinite(value) else None


def _correction(found: Correction | None) -> dict[str, Any] | None:
    """What the right formula does, where the model has a wrong one."""
    if found is None:
        return None
    return {
        "sentence": found.sentence,
        "chi2_per_sample": number(found.fit.chi2_per_sample),
        "parameters": parameters_answer(found.parameters),
        "wrong_chi2_per_sample": number(found.wrong.chi2_per_sample),
        "where": [_place(place) for place in found.places],
    }


def _suspect(suspect: Suspect) -> dict[str, Any]:
    return {
        "effect": suspect.effect,
        "joints": list(suspect.joints),
        "delta_bic": number(suspect.delta_bic),
        "p_value": number(suspect.p_value),
        "rmse": errors(suspect.rmse),
        "held_out_rmse": errors(suspect.held_out_rmse),
        "parameters": parameters_answer(suspect.parameters),
        "tied_with": list(suspect.tied_with),
    }


def _place(place: Place) -> dict[str, Any]:
    return {
        "channel": place.channel,
        "run": place.run,
        "against": place.against,
        "from": number(place.start),
        "to": number(place.end),
        "unit": place.unit,
        "chi2_per_sample": number(place.chi2_per_sample),
        "share": number(place.share),
    }


def _one_or_list(names: Iterable[str]) -> Any:
    """Null, one name, or several names joined by `` + `` where they only help together."""
    return " + ".join(names) or None
