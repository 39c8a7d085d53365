"""`armdyn repair`: add the effects that a model lacks, one after the other."""

from pipeline.console.inputs import Inputs
from pipeline.console.options import JsonOption, NamedOnlyOption, OutputOption, ReportOption
from pipeline.console.repaired import conclude_repair

PANEL = "What a model lacks"


def repair(
    inputs: Inputs,
    output: OutputOption = None,
    named_only: NamedOnlyOption = False,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add the effects that are missing, one after the other, and watch the error fall."""
    with inputs.begin(report, json_file, output, over_model=True) as (given, say):
        found = given.repair(say)
    conclude_repair(inputs, given, found, output or inputs.model, report, json_file, named_only=named_only)
