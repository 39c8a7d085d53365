"""`armdyn add`: a model with one more effect, fitted again."""

from typing import Annotated

import typer

from pipeline.console.inputs import Inputs, stopped_if_wrong
from pipeline.console.options import JsonOption, OutputOption, ReportOption
from pipeline.console.repaired import conclude_repair
from pipeline.console.screen import spinner

PANEL = "What a model lacks"


def add(
    inputs: Inputs,
    effect: Annotated[str, typer.Argument(metavar="EFFECT[:JOINT,...]", help="Name of the effect, with its joints.")],
    output: OutputOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add an effect to a model and refit."""
    from armdyn.effects.catalogue import find
    from armdyn.identify.repair import add as extend

    inputs.check_repair(output, report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read(adding=effect)
        wanted = find(effect, given.catalogue)
        given.file.model.with_effect(wanted)  # refuses an effect that does not fit before anything is fitted
        say("fitting")
        found = extend(given.study, [wanted])
        given.require_plausible(found.model)
    conclude_repair(inputs, given, found, output or inputs.model, report, json_file)
