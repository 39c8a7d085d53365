"""The report of a repair."""

from armdyn.identify.repair import Repair
from armdyn.identify.study import Study
from pipeline.report.comparison import fit_sections, key_figures, runs_of
from pipeline.report.diagnosis import LEVELS
from pipeline.report.page import Report
from pipeline.report.sections.ladder import LadderSection


def repair_report(study: Study, found: Repair, command: str = "") -> Report:
    """The error falling, then the repaired fit."""
    return Report(
        title="Repair: add what is missing, watch the error fall",
        level=LEVELS[found.verdict],
        verdict=found.sentence,
        sections=[LadderSection(found.ladder, study.judges), *fit_sections(found.after)],
        subtitle=runs_of(study),
        key_figures=key_figures(found.after),
        command=command,
    )
