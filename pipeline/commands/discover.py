"""`armdyn discover`: a formula for the force that a model lacks, as a file of effects."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.document import Document, NextStep
from pipeline.console.inputs import Inputs, UnexaminedInputs, checked
from pipeline.console.options import JsonOption, ReportOption
from pipeline.console.screen import finish

if TYPE_CHECKING:
    from armdyn.discovery.result import Discovery

PANEL = "What a model lacks"


def discover(
    inputs: UnexaminedInputs,
    output: Annotated[
        Path | None, typer.Option("--output", "--out", help="Python file of effects that holds what was discovered.")
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Find a formula for the force that a model lacks, and write it as an effect."""
    with inputs.begin(report, json_file, output) as (given, say):
        found = given.discover(say)
    if output is not None and found.new:
        found.write(output)
    aside = [f"{text}." for text in given.set_aside]
    document = replace(found.document(), notes=aside, next_steps=_next_steps(inputs, found, output))
    notes = [f"written to {output}"] if output is not None and found.new else []
    finish(
        document, lambda: {**_answer(found, output), **checked(given)}, json_file, report,
        lambda: _page(document, found), notes,
    )  # fmt: skip


def _page(document: Document, found: "Discovery") -> Document:
    from pipeline.report.missing_force import missing_force_sections

    added = " + ".join(one.effect for one in found.findings)
    return replace(document, sections=[*missing_force_sections(found.missing_force, added), *document.sections])


def _next_steps(inputs: Inputs, found: "Discovery", output: Path | None) -> list[NextStep]:
    """Next steps after a discovery: add the found effect, and make the recording or experiment that would say more."""
    another = inputs.command("discover", "--held-out", "ANOTHER.csv")
    judge = [NextStep("record another motion, and hold it out", another)] if not found.judged else []
    if not found.findings:
        return judge if found.leaves_something else []
    first = found.findings[0]
    file = output or Path("effect.py")
    own = ["--effects", str(file)] if first.term is not None else []
    words = ["armdyn", "add", str(inputs.model), first.label, *map(str, inputs.runs)]
    words += [word for path in inputs.held_out or () for word in ("--held-out", str(path))]
    steps = [NextStep("add it", shlex.join([*words, *own, "--output", "repaired.toml"]))]
    if len(found.findings) > 1:
        steps = [
            NextStep("add them all", inputs.command("repair", "--effects", str(file), "--output", "repaired.toml"))
        ]
    return [*steps, *judge, *_told_apart(inputs, found, file)]


def _told_apart(inputs: Inputs, found: "Discovery", file: Path) -> list[NextStep]:
    """The experiment that distinguishes a pendulum's found law from an equally good effect of the catalogue."""
    rival = next((one for one in found.new if one.known_as and one.joint is None), None)
    if rival is None:
        return []
    words = ("--effects", str(file), "--rivals", f"{rival.effect},{rival.known_as}", "--output", "motion.csv")
    return [NextStep("tell them apart", inputs.command("next", *words))]


def _answer(found: "Discovery", output: Path | None) -> dict[str, Any]:
    """JSON of `discover`."""
    from pipeline.answers import missing_force_answer, parameters_answer
    from pipeline.fields import fields, plain

    return {
        "schema": "armdyn.discover/1",
        "sentence": found.sentence,
        "found": [
            {
                **fields(one, "effect joint acts_on kind formula depends_on"),
                "values": parameters_answer(one.values),
                "explains": one.explains,
                "held_out_rmse": plain(found.held_out_rmse),
                **fields(one, "known_as rivals"),
                "output": str(output) if output is not None and one.term is not None else None,
            }
            for one in found.findings
        ],
        "missing_force": missing_force_answer(found.missing_force),
    }
