"""`armdyn repair`: the effects that a model lacks, added one after the other."""

from pipeline.console.inputs import Inputs, stopped_if_wrong
from pipeline.console.options import JsonOption, OutputOption, ReportOption
from pipeline.console.repaired import conclude_repair
from pipeline.console.screen import spinner

PANEL = "What a model lacks"


def repair(
    inputs: Inputs,
    output: OutputOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add the effects that are missing, one after the other, and watch the error fall."""
    from armdyn.identify.repair import repair as mend

    inputs.check_repair(output, report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        found = mend(given.study, say)
        given.require_plausible(found.model)
    conclude_repair(inputs, given, found, output or inputs.model, report, json_file)
