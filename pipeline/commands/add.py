"""`armdyn add`: add one effect, refit, show the error fall."""

from typing import Annotated

import typer

from pipeline.commands.identify_options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    ModelArgument,
    OutputOption,
    ReportOption,
    RunsArgument,
    check_outputs,
    inputs_of,
    read_study,
    spinner,
)
from pipeline.commands.output import JsonOption
from pipeline.commands.repair import conclude


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(add)


def add(
    model: ModelArgument,
    effect: Annotated[str, typer.Argument(metavar="EFFECT[:JOINT,...]", help="Name of the effect, with its joints.")],
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    output: OutputOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add an effect to a model and refit."""
    from armdyn.effects.catalogue import find
    from armdyn.identify.repair import add as extend

    check_outputs(output, report, json_file, inputs=inputs_of(model, output, [*runs, *(held_out or ()), *(exam or ())]))
    with spinner() as say:
        given = read_study(model, runs, held_out, effects, exam)
        wanted = find(effect, given.catalogue)
        given.file.model.with_effect(wanted)  # says what is wrong before anything is fitted
        say("fitting")
        found = extend(given.study, [wanted])
    conclude(given, found, output or model, report, json_file)
