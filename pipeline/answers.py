"""JSON output of the commands compare, diagnose, add, repair and inspect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from armdyn.recording.preparation import combined_preparations
from armdyn.recording.spikes import outlier_counts
from pipeline.fields import attributes_as_json, finite_or_none, json_value

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


def comparison_json(study: Study, found: Comparison) -> dict[str, Any]:
    """JSON output of the command `compare`, ``armdyn.comparison/1``."""
    return {
        "schema": "armdyn.comparison/1",
        "model": starting_model_json(study),
        **attributes_as_json(found, "verdict explained sentence"),
        **model_fit_json(found),
        **rollout_json(found),
        "missing_force": missing_force_json(found.missing_force),
    }


def diagnosis_json(study: Study, found: Diagnosis) -> dict[str, Any]:
    """JSON output of the command `diagnose`, ``armdyn.diagnosis/1``."""
    candidate = "effect joints delta_bic p_value rmse held_out_rmse parameters= tied_with"
    return {
        "schema": "armdyn.diagnosis/1",
        "model": starting_model_json(study),
        **attributes_as_json(found, "verdict sentence"),
        **model_fit_json(found.comparison),
        "candidates": [
            attributes_as_json(s, candidate, parameters=parameters_json(s.parameters)) for s in found.ranked_effects
        ],
        **attributes_as_json(found, "remedies cannot_be_seen=unidentified_effects"),
        "unknown": residual_character_json(found.residual_character),
        "missing_force": missing_force_json(found.missing_force),
    }


def repair_json(found: Repair) -> dict[str, Any]:
    """JSON output of the commands `repair` and `add`, ``armdyn.repair/1``; its entry `removed` is always empty."""
    step_names = "added= joints removed= tied_with rmse held_out_rmse exam_rmse chi2_per_sample bic"
    return {
        "schema": "armdyn.repair/1",
        **attributes_as_json(found, "verdict sentence explained"),
        "effects": [effect.name for effect in found.model.named_effects],
        "named": [attributes_as_json(one, "effect joints share headline") for one in found.named],
        **model_fit_json(found.after),
        **background_force_json(found.model),
        **rollout_json(found.after),
        "steps": [
            attributes_as_json(step, step_names + " values" * bool(step.values), added=_joined(step.added), removed=[])
            for step in found.path
        ],
        "links": [link_inertia_json(link) for link in found.links],
        "unknown": residual_character_json(found.residual_character),
        "missing_force": missing_force_json(found.missing_force),
    }


def inspection_json(found: Inspection) -> dict[str, Any]:
    """JSON output of `inspect`, and of a command that stops because a recording has a mistake: ``armdyn.inspect/1``."""
    return {
        "schema": "armdyn.inspect/1",
        **attributes_as_json(found, "usable sentence"),
        "recording_checks": recording_checks_json(found.checks),
    }


def recording_checks_json(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """JSON of the mistakes that were found in recordings, a dictionary per mistake."""
    names = "kind severity run channels from=start to=end evidence sentence remedy"
    return [attributes_as_json(check, names) for check in checks]


def link_inertia_json(link: Any) -> dict[str, Any]:
    """JSON of an `armdyn.arm.links.LinkInertiaChange`: identified and URDF mass, centre and inertia of a link."""
    quantities = {q.name: attributes_as_json(q, "unit urdf=described value std determined") for q in link.quantities}
    return {"joint": link.joint, **quantities, "physical": link.physical, "warning": link.warning or None}


def starting_model_json(study: Study) -> dict[str, Any]:
    """JSON of the model that a study starts from: its base model and its effects."""
    return {"base": study.model.base, "effects": [effect.name for effect in study.model.named_effects]}


def model_fit_json(found: Comparison) -> dict[str, Any]:
    """JSON of a fitted model: parameters, error by channel, and where in the recordings the error is largest."""
    from armdyn.identify.bands import COVERAGE_LEVEL

    quality = "unit noise_std rmse held_out_rmse exam_rmse chi2_per_sample whiteness_p_value"
    covered = found.bands.coverage if found.bands else {}
    left = {one.run: None for one in found.bands.extrapolations} if found.bands else {}
    return {
        "parameters": parameters_json(found.parameters),
        **background_force_json(found.fit.problem.model),
        **attributes_as_json(
            found, "intervals_hold std_widened_by=std_inflation at_bound not_determined=undetermined left_out"
        ),
        "not_told_apart": [
            attributes_as_json(one, "changes settled_by=identifying_states") for one in found.unidentified_combinations
        ],
        "outliers": outlier_counts(found.fit.problem.runs),
        "bands": {
            c: {"level": COVERAGE_LEVEL, "covered": v, "does_not_hold_in": list(left)} for c, v in covered.items()
        },
        "channels": {name: attributes_as_json(channel, quality) for name, channel in found.channels.items()},
        "preparation": signal_preparation_json(found.fit.problem),
        "behaves_like_dynamics": finite_or_none(found.process_error),
        "where": [
            attributes_as_json(place, "channel run against from=start to=end unit chi2_per_sample share")
            for place in found.failing_ranges
        ],
    }


def signal_preparation_json(problem: Problem) -> dict[str, Any]:
    """JSON of the filters and sampling rates that were applied to each channel of the training runs before the fit."""
    names = "cutoff_hz=cutoff position_cutoff_hz=position_cutoff rate_hz=rate samples recorded_rate_hz=recorded_rate "
    done = combined_preparations(run.preparations for run in problem.runs)
    return {name: attributes_as_json(each, names + "recorded left_out") for name, each in done.items()}


def missing_force_json(curves: Iterable[ForceCurve]) -> list[dict[str, Any]]:
    """JSON of the force that a model lacks: a curve per run, joint and quantity it may depend on, in six digits."""

    def short(curve: ForceCurve, name: str) -> Any:
        values = getattr(curve, name)
        return None if values is None else json_value([float(f"{value:.6g}") for value in values])

    names = ("x", "as_given", "std", "repaired")
    return [
        attributes_as_json(curve, "run joint unit against")
        | {name: short(curve, name) for name in names + ("with_background",) * (curve.with_background is not None)}
        for curve in curves
    ]


def parameters_json(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """JSON of parameters by name: value, standard deviation, unit, and whether the parameter was fitted."""
    return {name: attributes_as_json(p, "value std unit fitted") for name, p in parameters.items()}


def background_force_json(model: Model) -> dict[str, Any]:
    """JSON of a model's background, the smooth force without a named effect; empty for a model without one."""
    if model.background is None:
        return {}
    values = {name: finite_or_none(model.value(name)) for name in model.background.names}
    return {"background": {"width": model.background.width, "values": values}}


def rollout_json(compared: Comparison) -> dict[str, Any]:
    """JSON of an arm's identified drives, and of the errors of its simulated motion; empty where there are none."""
    answer: dict[str, Any] = {}
    if compared.drives:
        answer["drives"] = {
            name: attributes_as_json(
                servo,
                "law gain= determined delay",
                gain=servo.gain and attributes_as_json(servo.gain, "value std unit"),
            )
            for name, servo in compared.drives.items()
        }
    if compared.rollout:
        aside = (r.position_is_command and dict(zip(("rms", "mae"), r.position_is_command, strict=True))
                 for r in compared.rollout)  # fmt: skip
        names = "run role kind joint unit rms mae position_is_command="
        answer["rollout"] = [
            attributes_as_json(r, names, position_is_command=a) for r, a in zip(compared.rollout, aside, strict=True)
        ]
    return answer


def residual_character_json(found: ResidualCharacter | None) -> dict[str, Any] | None:
    """JSON of the character of an unexplained residual: expressions and frequencies; None without such a residual."""
    if found is None:
        return None
    return {
        **attributes_as_json(found, "sentence behaves_like_dynamics=process_error"),
        "terms": [attributes_as_json(term, "channel expression share") for term in found.terms],
        "frequencies": [attributes_as_json(peak, "channel frequency amplitude unit") for peak in found.peaks],
    }


def _joined(names: Iterable[str]) -> str | None:
    """The names of effects that were added together, joined by `` + ``; None without a name."""
    return " + ".join(names) or None
