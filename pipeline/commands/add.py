"""`armdyn add`: a model with one more effect, fitted again."""

from typing import Annotated

import typer

from pipeline.console.inputs import Inputs
from pipeline.console.options import JsonOption, NamedOnlyOption, OutputOption, ReportOption
from pipeline.console.repaired import conclude_repair

PANEL = "What a model lacks"


def add(
    inputs: Inputs,
    effect: Annotated[str, typer.Argument(metavar="EFFECT[:JOINT,...]", help="Name of the effect, with its joints.")],
    output: OutputOption = None,
    named_only: NamedOnlyOption = False,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add an effect to a model and refit."""
    from armdyn.effects.catalogue import find

    with inputs.begin(report, json_file, output, over_model=True, adding=effect) as (given, say):
        wanted = find(effect, given.known.catalogue)
        given.study.model.with_effect(wanted)  # refuses an effect that does not fit before anything is fitted
        say("fitting")
        found = given.add([wanted])
    conclude_repair(inputs, given, found, output or inputs.model, report, json_file, named_only=named_only)
