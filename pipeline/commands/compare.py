"""`armdyn compare`: a model compared with recordings."""

from dataclasses import replace

from armdyn.document import NextStep
from pipeline.console.inputs import Inputs, checked
from pipeline.console.options import JsonOption, ReportOption
from pipeline.console.repaired import REPAIRED
from pipeline.console.screen import finish

PANEL = "What a model lacks"


def compare(
    inputs: Inputs,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Fit what is free, and say how well the model does and where it fails."""
    from pipeline.answers import comparison_answer
    from pipeline.report.repair import comparison_report

    with inputs.begin(report, json_file, choosing=False) as (given, say):
        say("fitting")
        found = given.compare()

    document = found.document()
    if not found.explained:
        document = replace(document, next_steps=[NextStep("what is missing", inputs.command("repair", *REPAIRED))])
    finish(
        document,
        lambda: {**comparison_answer(given.study, found), **checked(given)},
        json_file,
        report,
        lambda: comparison_report(given.study, found),
        failed=bool(found.lost),
    )
