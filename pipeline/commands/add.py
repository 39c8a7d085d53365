"""`armdyn add`: a model with more effects, fitted again."""

from typing import Annotated

import typer

from pipeline.console.inputs import StudyInputs
from pipeline.console.options import NamedOnlyOption, OutputOption
from pipeline.console.repaired import conclude_repair

PANEL = "What a model lacks"


def add(
    inputs: StudyInputs,
    effect: Annotated[
        str,
        typer.Argument(metavar="EFFECT[:JOINT,...]", help="Its name, with its joints; several with '+' between them."),
    ],
    output: OutputOption = None,
    named_only: NamedOnlyOption = False,
) -> None:
    """Add one effect or several to a model and refit."""
    from armdyn.effects.catalogue import find_several

    with inputs.begin(output, over_model=True, adding=effect) as (given, say):
        wanted = find_several(effect, given.known.catalogue)
        for each in wanted:
            given.study.model.with_effect(each)  # an unsuitable effect is refused before the fit
        say("fitting")
        found = given.add(wanted)
    conclude_repair(inputs, given, found, output or inputs.model, named_only=named_only)
