"""The report of a comparison."""

from armdyn.identify.compare import Comparison
from armdyn.identify.study import Study
from pipeline.report.page import KeyFigure, Level, Report
from pipeline.report.section import Section
from pipeline.report.sections.dependence import DependenceSection
from pipeline.report.sections.fit import FitSection, FormulaSection
from pipeline.report.sections.parameters import ParameterSection
from pipeline.report.text import number


def comparison_report(study: Study, found: Comparison, command: str = "") -> Report:
    """Measured against predicted, where it fails, on what the residual depends, the parameters."""
    return Report(
        title="Compare: the model against recordings",
        level=Level.GOOD if found.explained else Level.CAUTION,
        verdict=found.sentence,
        sections=[*fit_sections(found), *formula_sections(found)],
        subtitle=runs_of(study),
        key_figures=key_figures(found),
        command=command,
    )


def fit_sections(found: Comparison) -> list[Section]:
    """What every report about a fit shows."""
    return [FitSection(found.fit, found.places), DependenceSection(found.fit), ParameterSection(found)]


def formula_sections(found: Comparison) -> list[Section]:
    """Where a formula that is known to be wrong fails; nothing where the model has none."""
    if found.correction is None:
        return []
    wrong = found.correction.wrong
    return [FormulaSection(wrong, found.correction.places), DependenceSection(wrong)]


def key_figures(found: Comparison) -> list[KeyFigure]:
    """χ² per sample, then the error of the first channels."""
    figures = [KeyFigure("χ² per sample", f"{found.fit.chi2_per_sample:.4g}", "1 is noise")]
    for name, channel in list(found.channels.items())[:4]:
        held_out, exam = channel.held_out_rmse, channel.exam_rmse
        note = f"held out {number(held_out, channel.unit)}" if held_out is not None else "nothing held out"
        note += f", exam {number(exam, channel.unit)}" if exam is not None else ""
        figures.append(KeyFigure(name, number(channel.rmse, channel.unit), note))
    return figures


def runs_of(study: Study) -> str:
    """Which recordings."""
    kinds = {"": study.runs, "; held out: ": study.held_out, "; exam: ": study.exam}
    return "".join(kind + ", ".join(run.name for run in runs) for kind, runs in kinds.items() if runs)
