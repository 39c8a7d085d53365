"""`armdyn add`: a model with one more effect, fitted again."""

from typing import Annotated

import typer

from pipeline.console.inputs import Inputs, stopped_if_wrong
from pipeline.console.options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    JsonOption,
    ModelArgument,
    OutputOption,
    ReportOption,
    RunsArgument,
    TrustOption,
)
from pipeline.console.repaired import conclude_repair
from pipeline.console.screen import spinner

PANEL = "What a model lacks"


def add(
    model: ModelArgument,
    effect: Annotated[str, typer.Argument(metavar="EFFECT[:JOINT,...]", help="Name of the effect, with its joints.")],
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    output: OutputOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Add an effect to a model and refit."""
    from armdyn.effects.catalogue import find
    from armdyn.identify.repair import add as extend

    inputs = Inputs(model, runs, held_out, exam, effects, trust_data)
    inputs.check_repair(output, report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read(adding=effect)
        wanted = find(effect, given.catalogue)
        given.file.model.with_effect(wanted)  # refuses an effect that does not fit before anything is fitted
        say("fitting")
        found = extend(given.study, [wanted])
        given.require_plausible(found.model)
    conclude_repair(inputs, given, found, output or model, report, json_file)
