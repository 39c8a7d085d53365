"""The command `armdyn compare`: compare a model with recordings."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from armdyn.document import NextStep
from armdyn.errors import InputError
from pipeline.console.inputs import StudyInputs
from pipeline.console.repair_result import repair_output_options

HELP_PANEL = "What a model lacks"


ResidualOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "--out",
        help="CSV with what the model, as it is in its file, leaves of each channel of one recording: of a "
        "force/torque sensor the compensated wrench.",
    ),
]


def compare(inputs: StudyInputs, output: ResidualOption = None) -> None:
    """Fit a model's free parameters to recordings, and report how well it predicts them and where it fails."""
    from armdyn.front import residual
    from armdyn.run import write_run_csv
    from pipeline.answers import comparison_json
    from pipeline.report.repair import comparison_report

    if output is not None and len(inputs.runs) != 1:
        raise InputError(f"--output {output}: it holds what is left of one recording: give one")
    with inputs.begin(output, choosing=False) as (given, say):
        say("fitting")
        found = given.compare()
    written = []
    if output is not None:
        write_run_csv(residual(given.known.file.model, inputs.runs[0]), output)
        written = [f"measured less predicted written to {output}"]
    steps = (
        []
        if found.explained
        else [NextStep("what is missing", inputs.proposed_command("repair", *repair_output_options(inputs.model)))]
    )
    inputs.finish(
        given,
        replace(found.document(), next_steps=steps, notes=[f"Fitted to these runs; {inputs.model} keeps its values."]),
        lambda: comparison_json(given.study, found),
        lambda: comparison_report(given.study, found),
        written,
        failed=bool(found.lost),
    )
