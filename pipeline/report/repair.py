"""The reports of compare, diagnose, add and repair: the document of a result, and figures of every run."""

from collections.abc import Sequence
from dataclasses import replace

from armdyn.document import Document, KeyFigure, NextStep, Section
from armdyn.identify.compare import Comparison
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.explained_share import ChannelScale, RepairStep, percent_text
from armdyn.identify.fit import Fit
from armdyn.identify.repair import Repair
from armdyn.identify.selection.search import repair_step
from armdyn.identify.sentence import HOLDOUT_KIND_TEXT, MAX_NAMED_EFFECTS, named_effects
from armdyn.identify.study import Study
from armdyn.identify.tables import step_name
from pipeline.report.fit import channel_error_section, fit_key_figures, residual_dependence_section, run_names_by_role
from pipeline.report.missing_force import missing_force_sections
from pipeline.report.motion import with_motion_charts
from pipeline.report.overlay import OverlayFigure


def comparison_report(study: Study, found: Comparison) -> Document:
    """Report of the comparison of a model with recordings: figures of signals and residuals, errors, parameters.

    Args:
        study: runs and model.
        found: result of the comparison.
    """
    missing = missing_force_sections(found.missing_force)
    shown = OverlayFigure.of_study(study, [found.fit], ["as given"], found.failing_ranges, found.bands)
    made = _illustrated(found.document(), study, missing, shown, found.fit, "this model")
    title = "Compare: the model against recordings"
    return replace(made, title=title, sections=with_motion_charts(made.sections, found.rollout))


def diagnosis_report(study: Study, found: Diagnosis) -> Document:
    """Report of a diagnosis: how much each candidate effect would reduce the error, and curves with the best effects.

    Args:
        study: runs, model and candidate effects.
        found: result of the diagnosis.
    """
    path = [repair_step(study, step) for step in found.search.steps]
    missing = missing_force_sections(found.missing_force, _added(path, found.comparison.scale))
    fits, steps = [step.fit for step in found.search.steps], [step_name(step) for step in path]
    shown = OverlayFigure.of_study(study, fits, steps, found.comparison.failing_ranges)
    document = found.document(_summaries(study))
    made = _illustrated(document, study, missing, shown, found.comparison.fit, "the model as given")
    return replace(made, title="Diagnose: which effect is missing")


def repair_report(study: Study, found: Repair, next_steps: Sequence[NextStep] = ()) -> Document:
    """Report of a repair: errors before and after each added effect, parameters, and figures of the repaired model.

    Args:
        study: runs, model and candidate effects.
        found: result of the repair.
        next_steps: commands that the reader may run next.
    """
    missing = missing_force_sections(found.missing_force, _added(found.path, found.after.scale))
    fits, steps = [step.fit for step in found.steps], [step_name(step) for step in found.path]
    shown = OverlayFigure.of_study(study, fits, steps, found.after.failing_ranges, found.after.bands)
    document = found.document(study.holdout_kinds, _summaries(study))
    made = _illustrated(document, study, missing, shown, found.after.fit, "the last step")
    figures = list(made.key_figures)
    if len(found.path) > 1:
        whose = HOLDOUT_KIND_TEXT[study.holdout_kinds[0]].rstrip(",")
        figures.insert(0, KeyFigure("Misfit explained", percent_text(found.explained), f"by what was added; {whose}"))
    title, sections = (
        "Repair: add what is missing, watch the error fall",
        with_motion_charts(made.sections, found.after.rollout),
    )
    return replace(made, title=title, sections=sections, key_figures=figures, next_steps=next_steps)


def _illustrated(
    document: Document, study: Study, missing: Sequence[Section], shown: OverlayFigure, fit: Fit, whose: str
) -> Document:
    """Document of a result with figures: missing force and curves first, residuals above the parameters.

    Args:
        document: what the result says of itself.
        study: runs and model.
        missing: figures of the missing force.
        shown: curves of measured and predicted signals.
        fit: whose residuals are shown.
        whose: model that is, for a reader.
    """
    place = [section.title for section in document.sections].index("Parameters")
    return replace(
        document,
        sections=[
            *missing,
            shown.section(),
            *document.sections[:place],
            channel_error_section(shown),
            residual_dependence_section(fit, whose),
            *document.sections[place:],
        ],
        subtitle=run_names_by_role(study),
        key_figures=fit_key_figures(shown),
    )


def _added(path: Sequence[RepairStep], scale: ChannelScale) -> str:
    """Names of the effects that were added to the given model, for a legend."""
    effects = [one.text for one in named_effects(path, scale)]
    return " + ".join(effects) if len(effects) <= MAX_NAMED_EFFECTS else f"with {len(effects)} effects"


def _summaries(study: Study) -> dict[str, str]:
    return {name: effect.summary for name, effect in study.effects.items()}
