"""The report of a diagnosis."""

from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.study import Study
from armdyn.identify.verdict import Verdict
from pipeline.report.comparison import fit_sections, key_figures, runs_of
from pipeline.report.page import Level, Report
from pipeline.report.sections.evidence import EvidenceSection

LEVELS = {
    Verdict.EXPLAINED: Level.GOOD,
    Verdict.EFFECT_MISSING: Level.CAUTION,
    Verdict.CANNOT_TELL_APART: Level.CAUTION,
    Verdict.UNKNOWN_EFFECT: Level.CAUTION,
}


def diagnosis_report(study: Study, found: Diagnosis, command: str = "") -> Report:
    """The candidates with their evidence, then the fit as it is."""
    return Report(
        title="Diagnose: which effect is missing",
        level=LEVELS[found.verdict],
        verdict=found.sentence,
        sections=[EvidenceSection(found.suspects, found.remedies), *fit_sections(found.comparison)],
        subtitle=runs_of(study),
        key_figures=key_figures(found.comparison),
        command=command,
    )
