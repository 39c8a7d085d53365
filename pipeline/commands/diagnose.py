"""`armdyn diagnose`: which effect is missing."""

import shlex
import sys
from pathlib import Path

import typer

from pipeline.commands.identify_options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    ModelArgument,
    ReportOption,
    RunsArgument,
    check_outputs,
    read_study,
    say_fit,
    say_places,
    spinner,
)
from pipeline.commands.output import JsonOption, to_screen, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(diagnose)


def diagnose(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Find out which physical effect is missing, with an honest verdict."""
    from rich.table import Table

    from armdyn.identify.diagnose import diagnose as find_missing

    check_outputs(report, json_file, inputs=[model, *runs, *(held_out or ()), *(exam or ())])
    with spinner() as say:
        given = read_study(model, runs, held_out, effects, exam)
        found = find_missing(given.study, say)
        if report is not None:
            from pipeline.report.diagnosis import diagnosis_report

            diagnosis_report(given.study, found, shlex.join(["armdyn", *sys.argv[1:]])).write(report)
    if json_file is not None:
        from pipeline.answers import diagnosis_answer

        write_json(diagnosis_answer(given.study, found), json_file)
    if json_file == Path("-"):
        return
    console = to_screen()
    console.print(f"[bold]{found.verdict.key}[/]: {found.sentence}")
    if found.suspects:
        table = Table("effect", "ΔBIC", "p", "tied with", box=None, header_style="dim")
        for s in found.suspects:
            name = f"{s.effect}:{','.join(s.joints)}" if s.joints else s.effect
            table.add_row(name, f"{s.delta_bic:.1f}", f"{s.p_value:.1e}", ", ".join(s.tied_with))
        console.print(table)
    for name, imitators in found.unseen.items():
        console.print(f"[dim]{name} cannot be seen in these runs: {', '.join(imitators)} does the same.[/]")
    say_fit(found.comparison)
    say_places(found.comparison.places)
