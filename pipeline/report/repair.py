"""The reports of compare, diagnose, add and repair: the document of a result, and figures of every run."""

from collections.abc import Sequence
from dataclasses import replace

from armdyn.document import Document, KeyFigure, NextStep, Section
from armdyn.identify.compare import Comparison
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.explained_share import percent_text
from armdyn.identify.repair import Repair
from armdyn.identify.selection.search import repair_step
from armdyn.identify.sentence import HOLDOUT_KIND_TEXT
from armdyn.identify.study import Study
from armdyn.identify.tables import step_name
from pipeline.report.fit import channel_error_section, fit_key_figures, residual_dependence_section, run_names_by_role
from pipeline.report.missing_force import missing_force_sections
from pipeline.report.motion import with_motion_charts
from pipeline.report.overlay import OverlayFigure

VALUES = ("Parameters", "Drives")
"""Titles of the sections with the values of a repaired or compared model."""


def comparison_report(study: Study, found: Comparison) -> Document:
    """Report of the comparison of a model with recordings: figures of signals and residuals, errors, parameters.

    Args:
        study: runs and model.
        found: result of the comparison.
    """
    missing = missing_force_sections(found.missing_force)
    shown = OverlayFigure.of_study(study, [found.fit], ["as given"], found.failing_ranges, found.bands)
    made = _illustrated(found.document(), study, missing, shown, found, "this model", VALUES)
    title = "Compare: the model against recordings"
    return replace(made, title=title, sections=with_motion_charts(made.sections, found.rollout, shown.tabs))


def diagnosis_report(study: Study, found: Diagnosis) -> Document:
    """Report of a diagnosis: how much each candidate effect would reduce the error, and curves with the best effects.

    Args:
        study: runs, model and candidate effects.
        found: result of the diagnosis.
    """
    missing = missing_force_sections(found.missing_force, "with what is missing")
    fits = [step.fit for step in found.search.steps]
    steps = [step_name(repair_step(study, step)) for step in found.search.steps]
    shown = OverlayFigure.of_study(study, fits, steps, found.comparison.failing_ranges)
    document = found.document(_summaries(study))
    answer = (document.sections[0].title,)
    made = _illustrated(document, study, missing, shown, found.comparison, "the model as given", answer)
    return replace(made, title="Diagnose: which effect is missing")


def repair_report(study: Study, found: Repair, next_steps: Sequence[NextStep] = ()) -> Document:
    """Report of a repair: errors before and after each added effect, parameters, and figures of the repaired model.

    Args:
        study: runs, model and candidate effects.
        found: result of the repair.
        next_steps: commands that the reader may run next.
    """
    missing = missing_force_sections(found.missing_force)
    fits, steps = [step.fit for step in found.steps], [step_name(step) for step in found.path]
    shown = OverlayFigure.of_study(study, fits, steps, found.after.failing_ranges, found.after.bands)
    document = found.document(study.holdout_kinds, _summaries(study))
    made = _illustrated(document, study, missing, shown, found.after, "the last step", VALUES)
    figures = list(made.key_figures)
    if len(found.path) > 1:
        whose = HOLDOUT_KIND_TEXT[study.holdout_kinds[0]].rstrip(",")
        figures.insert(0, KeyFigure("Misfit explained", percent_text(found.explained), f"by what was added; {whose}"))
    title, sections = (
        "Repair: add what is missing, watch the error fall",
        with_motion_charts(made.sections, found.after.rollout, shown.tabs),
    )
    return replace(made, title=title, sections=sections, key_figures=figures, next_steps=next_steps)


def _illustrated(
    document: Document,
    study: Study,
    missing: Sequence[Section],
    shown: OverlayFigure,
    compared: Comparison,
    whose: str,
    answer: Sequence[str],
) -> Document:
    """Document of a result with figures: the answer first, then missing force and curves, errors and residuals.

    Args:
        document: what the result says of itself.
        study: runs and model.
        missing: figures of the missing force.
        shown: curves of measured and predicted signals.
        compared: the compared model, whose residuals are shown.
        whose: name of that model for a reader.
        answer: titles of the sections that come first.
    """
    left = {section.title: section for section in document.sections}

    def taken(*titles: str) -> list[Section]:
        return [left.pop(title) for title in titles if title in left]

    return replace(
        document,
        sections=[
            *taken(*answer),
            *missing,
            shown.section(),
            *taken("The error falling", "Links"),
            channel_error_section(shown, compared.channels),
            *taken("Where the model fails"),
            residual_dependence_section(compared.fit, whose),
            *left.values(),
        ],
        subtitle=run_names_by_role(study),
        key_figures=fit_key_figures(shown, compared.channels),
    )


def _summaries(study: Study) -> dict[str, str]:
    return {name: effect.summary for name, effect in study.effects.items()}
