"""The command `armdyn diagnose`: find which physical effect a model lacks."""

from dataclasses import replace

from armdyn.document import NextStep
from pipeline.console.inputs import StudyInputs
from pipeline.console.repair_result import next_experiment_steps, repair_output_options

HELP_PANEL = "What a model lacks"


def diagnose(inputs: StudyInputs) -> None:
    """Find out which physical effect a model lacks, or report that the recordings cannot decide."""
    from armdyn.identify.sentence import Verdict
    from pipeline.answers import diagnosis_json
    from pipeline.report.repair import diagnosis_report

    with inputs.begin() as (given, say):
        found = given.diagnose(say)
    steps = next_experiment_steps(inputs, given) if found.remedies else []
    if found.ranked_effects:
        steps.append(NextStep("add it", inputs.proposed_command("repair", *repair_output_options(inputs.model))))
    inputs.finish(
        given,
        replace(found.document(), verdict=f"{found.verdict.key}: {found.sentence}", next_steps=steps),
        lambda: diagnosis_json(given.study, found),
        lambda: diagnosis_report(given.study, found),
        failed=found.verdict is Verdict.LOST,
    )
