"""The command `armdyn add`: add effects to a model, and fit it again."""

from pathlib import Path
from typing import Annotated

import typer

from armdyn.errors import InputError
from pipeline.console.inputs import StudyInputs
from pipeline.console.options import NamedOnlyOption, OutputOption
from pipeline.console.repair_result import report_and_save_repair

HELP_PANEL = "What a model lacks"


def add(
    inputs: StudyInputs,
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT[:JOINT,...]", help="Name of the effect, and its joints; join several effects by '+'."
        ),
    ],
    output: OutputOption = None,
    named_only: NamedOnlyOption = False,
) -> None:
    """Add one or several effects to a model, and fit it again."""
    from armdyn.effects.catalogue import find_several

    if Path(effect).is_file():
        raise InputError(
            f"{effect}: is a file; the effect comes before the recordings: armdyn add M.toml EFFECT RUN..."
        )
    with inputs.begin(output, over_model=True, adding=effect) as (given, say):
        wanted = find_several(effect, given.known.catalogue)
        for each in wanted:
            given.study.model.with_effect(each)  # an unsuitable effect is refused before the fit
        say("fitting")
        found = given.add(wanted)
    report_and_save_repair(inputs, given, found, output or inputs.model, named_only=named_only)
