"""The report of a repair."""

from armdyn.identify.repair import Repair
from armdyn.identify.study import Study
from armdyn.identify.verdict import Verdict
from pipeline.report.comparison import fit_sections, key_figures, runs_of
from pipeline.report.page import Level, Report
from pipeline.report.sections.ladder import LadderSection
from pipeline.report.sections.links import LinkSection

MUCH = 0.5
"""Share of the misfit; a repair that explains more is an improvement, whatever it leaves."""


def repair_level(found: Repair) -> Level:
    """Done where only noise is left, improved where much is explained, failed only where the error grew."""
    if found.verdict is Verdict.EXPLAINED and found.after.widened == 1.0:
        return Level.GOOD
    if found.explained < 0.0:
        return Level.BAD
    return Level.IMPROVED if found.explained > MUCH else Level.CAUTION


def repair_report(study: Study, found: Repair, command: str = "") -> Report:
    """The error falling, what became of an arm's links, then the repaired fit."""
    links = [LinkSection(found.links)] if found.links else []
    return Report(
        title="Repair: add what is missing, watch the error fall",
        level=repair_level(found),
        verdict=found.sentence,
        sections=[LadderSection(found.ladder, found.after.scale, study.judges), *links, *fit_sections(found.after)],
        subtitle=runs_of(study),
        key_figures=key_figures(found.after),
        command=command,
    )
