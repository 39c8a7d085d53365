"""The command `armdyn repair`: add the effects that a model lacks, one after the other."""

from pipeline.console.inputs import StudyInputs
from pipeline.console.options import NamedOnlyOption, OutputOption
from pipeline.console.repair_result import report_and_save_repair

HELP_PANEL = "What a model lacks"


def repair(inputs: StudyInputs, output: OutputOption = None, named_only: NamedOnlyOption = False) -> None:
    """Add the effects that a model lacks, one after the other, and show how the error falls."""
    with inputs.begin(output, over_model=True) as (given, say):
        found = given.repair(say)
    report_and_save_repair(inputs, given, found, output or inputs.model, named_only=named_only)
