"""Answers in the form of the contract: what compare, diagnose, add, repair and inspect give as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from armdyn.recording.preparation import combined_preparations
from armdyn.recording.spikes import outlier_counts
from pipeline.fields import fields, number, plain

if TYPE_CHECKING:
    from armdyn.identify.compare import Comparison
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.problem import Problem
    from armdyn.identify.repair import Repair
    from armdyn.identify.residual.character import ResidualCharacter
    from armdyn.identify.residual.missing_force import ForceCurve
    from armdyn.identify.study import Study
    from armdyn.inspection.check import Check, Inspection
    from armdyn.model import Model
    from armdyn.parameter import Parameter


def comparison_answer(study: Study, found: Comparison) -> dict[str, Any]:
    """JSON of `compare`."""
    return {
        "schema": "armdyn.comparison/1",
        "model": model_answer(study),
        **fields(found, "verdict explained sentence"),
        **fit_answer(found),
        **rollout_answer(found),
        "missing_force": missing_force_answer(found.missing_force),
    }


def diagnosis_answer(study: Study, found: Diagnosis) -> dict[str, Any]:
    """JSON of `diagnose`."""
    candidate = "effect joints delta_bic p_value rmse held_out_rmse parameters= tied_with"
    return {
        "schema": "armdyn.diagnosis/1",
        "model": model_answer(study),
        **fields(found, "verdict sentence"),
        **fit_answer(found.comparison),
        "candidates": [fields(s, candidate, parameters=parameters_answer(s.parameters)) for s in found.suspects],
        **fields(found, "remedies cannot_be_seen=unidentified_effects"),
        "unknown": unknown_answer(found.residual_character),
        "missing_force": missing_force_answer(found.missing_force),
    }


def repair_answer(found: Repair) -> dict[str, Any]:
    """JSON of `repair` and `add`; `removed` is always empty and belongs to the format."""
    step_names = "added= joints removed= tied_with rmse held_out_rmse exam_rmse chi2_per_sample bic"
    return {
        "schema": "armdyn.repair/1",
        **fields(found, "verdict sentence explained"),
        "effects": [effect.name for effect in found.model.named_effects],
        **fit_answer(found.after),
        **background_answer(found.model),
        **rollout_answer(found.after),
        "steps": [
            fields(step, step_names + " values" * bool(step.values), added=_joined(step.added), removed=[])
            for step in found.path
        ],
        "links": [link_answer(link) for link in found.links],
        "unknown": unknown_answer(found.residual_character),
        "missing_force": missing_force_answer(found.missing_force),
    }


def inspection_answer(found: Inspection) -> dict[str, Any]:
    """JSON of `inspect`, and of every command that a recording's mistake has ended."""
    return {
        "schema": "armdyn.inspect/1",
        **fields(found, "usable sentence"),
        "recording_checks": checks_answer(found.checks),
    }


def checks_answer(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """The checks of any answer."""
    names = "kind severity run channels from=start to=end evidence sentence remedy"
    return [fields(check, names) for check in checks]


def history_entries(study: Study, found: Repair) -> list[dict[str, Any]]:
    """Entries of a model file's history, one for each step of a repair.

    `contribution` is the root mean square, by channel, of the effect of the step's terms in the repaired model.
    """
    names = {"runs": [run.name for run in study.runs], "held_out": [run.name for run in study.held_out]}
    if study.exam:
        names["exam"] = [run.name for run in study.exam]
    return [
        {
            "added": _joined(step.added),
            "joints": list(step.joints) or None,
            **names,
            "rmse": plain(step.rmse),
            "held_out_rmse": plain(step.held_out_rmse) or None,
            "exam_rmse": plain(step.exam_rmse) or None,
            **fields(step, "chi2_per_sample bic"),
            "contribution": plain(found.steps[-1].fit.contribution(step.added)),
            "as_given_rmse": plain(found.path[0].rmse) if k == 0 else None,
        }
        for k, step in enumerate(found.path[1:])
    ]


def link_answer(link: Any) -> dict[str, Any]:
    """A link in kg, m and kg m^2, beside the URDF's values; see `armdyn.arm.links.LinkChange`."""
    quantities = {q.name: fields(q, "unit urdf=described value std determined") for q in link.quantities}
    return {"joint": link.joint, **quantities, "physical": link.physical, "warning": link.warning or None}


def model_answer(study: Study) -> dict[str, Any]:
    """Base and effects of the model as given."""
    return {"base": study.model.base, "effects": [effect.name for effect in study.model.named_effects]}


def fit_answer(found: Comparison) -> dict[str, Any]:
    """Parameters, channels and places of one fit."""
    from armdyn.identify.bands import COVERAGE_LEVEL

    quality = "unit noise_std rmse held_out_rmse exam_rmse chi2_per_sample whiteness_p_value"
    bands = found.bands
    return {
        "parameters": parameters_answer(found.parameters),
        **background_answer(found.fit.problem.model),
        **fields(found, "intervals_hold std_widened_by=std_inflation at_bound not_determined=undetermined left_out"),
        "not_told_apart": [
            fields(one, "changes settled_by=identifying_states") for one in found.unidentified_combinations
        ],
        "outliers": outlier_counts(found.fit.problem.runs),
        "bands": {c: {"level": COVERAGE_LEVEL, "covered": v} for c, v in bands.coverage.items()} if bands else {},
        "channels": {name: fields(channel, quality) for name, channel in found.channels.items()},
        "preparation": preparation_answer(found.fit.problem),
        "behaves_like_dynamics": number(found.process_error),
        "where": [
            fields(place, "channel run against from=start to=end unit chi2_per_sample share")
            for place in found.failing_ranges
        ],
    }


def preparation_answer(problem: Problem) -> dict[str, Any]:
    """Per channel which part of the training runs was compared; empty where nothing was filtered."""
    names = "cutoff_hz=cutoff position_cutoff_hz=position_cutoff rate_hz=rate samples recorded_rate_hz=recorded_rate "
    done = combined_preparations(run.preparations for run in problem.runs)
    return {name: fields(each, names + "recorded left_out") for name, each in done.items()}


def missing_force_answer(curves: Iterable[ForceCurve]) -> list[dict[str, Any]]:
    """What a model cannot explain, a curve for each run, joint and quantity that it may depend on, in six digits."""

    def short(curve: ForceCurve, name: str) -> Any:
        values = getattr(curve, name)
        return None if values is None else plain([float(f"{value:.6g}") for value in values])

    names = ("x", "as_given", "std", "repaired")
    return [
        fields(curve, "run joint unit against")
        | {name: short(curve, name) for name in names + ("with_background",) * (curve.with_background is not None)}
        for curve in curves
    ]


def parameters_answer(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Values, standard deviations and units by name."""
    return {name: fields(p, "value std unit fitted") for name, p in parameters.items()}


def background_answer(model: Model) -> dict[str, Any]:
    """The background of a model as its file has it, in SI units; empty for a model without one."""
    if model.background is None:
        return {}
    values = {name: number(model.value(name)) for name in model.background.names}
    return {"background": {"width": model.background.width, "values": values}}


def rollout_answer(compared: Comparison) -> dict[str, Any]:
    """Identified drives of an arm, and its simulated against its recorded motion; empty where there are none."""
    answer: dict[str, Any] = {}
    if compared.drives:
        answer["drives"] = {
            name: fields(servo, "law gain= determined delay", gain=servo.gain and fields(servo.gain, "value std unit"))
            for name, servo in compared.drives.items()
        }
    if compared.rollout:
        aside = (r.position_is_command and dict(zip(("rms", "mae"), r.position_is_command, strict=True))
                 for r in compared.rollout)  # fmt: skip
        names = "run role kind joint unit rms mae position_is_command="
        answer["rollout"] = [
            fields(r, names, position_is_command=a) for r, a in zip(compared.rollout, aside, strict=True)
        ]
    return answer


def unknown_answer(found: ResidualCharacter | None) -> dict[str, Any] | None:
    """What is known of an effect outside the catalogue."""
    if found is None:
        return None
    return {
        **fields(found, "sentence behaves_like_dynamics=process_error"),
        "terms": [fields(term, "channel expression share") for term in found.terms],
        "frequencies": [fields(peak, "channel frequency amplitude unit") for peak in found.peaks],
    }


def _joined(names: Iterable[str]) -> str | None:
    """Null, one name, or several names joined by `` + `` where they only help together."""
    return " + ".join(names) or None
