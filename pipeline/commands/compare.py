"""The command `armdyn compare`: compare a model with recordings."""

from dataclasses import replace

from armdyn.document import NextStep
from pipeline.console.inputs import StudyInputs
from pipeline.console.repair_result import REPAIR_OUTPUT_OPTIONS

HELP_PANEL = "What a model lacks"


def compare(inputs: StudyInputs) -> None:
    """Fit a model's free parameters to recordings, and report how well it predicts them and where it fails."""
    from pipeline.answers import comparison_json
    from pipeline.report.repair import comparison_report

    with inputs.begin(choosing=False) as (given, say):
        say("fitting")
        found = given.compare()
    steps = (
        []
        if found.explained
        else [NextStep("what is missing", inputs.proposed_command("repair", *REPAIR_OUTPUT_OPTIONS))]
    )
    inputs.finish(
        given,
        replace(found.document(), next_steps=steps),
        lambda: comparison_json(given.study, found),
        lambda: comparison_report(given.study, found),
        failed=bool(found.lost),
    )
