"""The command `armdyn discover`: find a formula for the force that a model lacks."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.document import Document, NextStep
from armdyn.quoting import shell_quoted_command
from pipeline.console.inputs import ModelAndRunInputs, StudyInputsWithoutExam
from pipeline.console.repair_result import repair_output_options

if TYPE_CHECKING:
    from armdyn.discovery.result import Discovery

HELP_PANEL = "What a model lacks"


def discover(
    inputs: StudyInputsWithoutExam,
    output: Annotated[
        Path | None, typer.Option("--output", "--out", help="Python file to write, with the formula as an effect.")
    ] = None,
) -> None:
    """Find a formula for the force that a model lacks, and write it as an effect."""
    with inputs.begin(output) as (given, say):
        found = given.discover(say)
    written = []
    if output is not None and found.laws_outside_catalogue:
        found.write(output)
        written = [f"written to {output}"]
    aside = [f"{text}." for text in given.set_aside]
    document = replace(found.document(), notes=aside, next_steps=_next_steps(inputs, found, output))

    def page() -> Document:
        from pipeline.report.missing_force import missing_force_sections

        missing = missing_force_sections(found.missing_force, "with what was found")
        return replace(document, sections=[*missing, *document.sections])

    inputs.finish(given, document, lambda: _answer(found, output), page, written)


def _next_steps(inputs: ModelAndRunInputs, found: "Discovery", output: Path | None) -> list[NextStep]:
    another = inputs.proposed_command("discover", "--held-out", "ANOTHER.csv")
    judge = [NextStep("record another motion, and hold it out", another)] if not found.has_unfitted_run else []
    if not found.laws:
        return judge if found.residual_exceeds_noise else []
    first = found.laws[0]
    file = output or Path("effect.py")
    own = ["--effects", file] if first.term is not None else []
    held_out = [word for path in inputs.held_out or () for word in ("--held-out", path)]
    outputs = repair_output_options(inputs.model)[:2]
    words = (inputs.model, first.label, *inputs.runs, *held_out, *own, *outputs)
    steps = [NextStep("add it", shell_quoted_command("add", *words))]
    if len(found.laws) > 1:
        steps = [NextStep("add them all", inputs.proposed_command("repair", "--effects", str(file), *outputs))]
    rival = next((one for one in found.laws_outside_catalogue if one.known_as and one.joint is None), None)
    if rival is not None:  # an equally good effect of the catalogue
        apart = ["--effects", str(file), "--rivals", f"{rival.effect},{rival.known_as}", "--output", "motion.csv"]
        judge.append(NextStep("distinguish them", inputs.proposed_command("next", *apart)))
    return [*steps, *judge]


def _answer(found: "Discovery", output: Path | None) -> dict[str, Any]:
    from pipeline.answers import missing_force_json, parameters_json
    from pipeline.fields import attributes_as_json, json_value

    return {
        "schema": "armdyn.discover/1",
        "sentence": found.sentence,
        "found": [
            {
                **attributes_as_json(one, "effect joint acts_on kind formula depends_on"),
                "values": parameters_json(one.values),
                "explains": one.explained_share,
                "held_out_rmse": json_value(found.held_out_rmse),
                **attributes_as_json(one, "known_as rivals"),
                "output": str(output) if output is not None and one.term is not None else None,
            }
            for one in found.laws
        ],
        "missing_force": missing_force_json(found.missing_force),
    }
