"""`armdyn next`: which experiment tells apart what the runs so far do not."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.identify import (
    EffectsOption,
    HeldOutOption,
    Inputs,
    ModelArgument,
    ReportOption,
    RunsArgument,
    TrustOption,
    say_report,
    stopped_if_wrong,
)
from pipeline.commands.output import JsonOption, answered, check_outputs, command_line, plain_table, spinner, to_screen

if TYPE_CHECKING:
    from armdyn.experiments.plan import Plan


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="next")(next_experiment)


def next_experiment(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    rivals: Annotated[
        str | None,
        typer.Option(help="Effects to tell apart, separated by commas; those that the diagnosis leaves, if not given."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration of the designed motion.")] = 8.0,
    output: Annotated[
        Path | None, typer.Option("--output", "--out", help="Where the designed motion goes: CSV along the line.")
    ] = None,
    travel: Annotated[
        float | None,
        typer.Option(help="Of a rig of your own, in place of Baxter: how far its gripper moves to either side [m]."),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="The same: its largest speed [m/s].")] = None,
    acceleration: Annotated[float | None, typer.Option(help="The same: its largest acceleration [m/s^2].")] = None,
    swing: Annotated[float | None, typer.Option(help="The same: the largest angle of the load [rad].")] = None,
    seed: Annotated[int, typer.Option(help="Of the random motions from which the design starts.")] = 0,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Plan the next experiment: how well each kind tells rival effects apart, and the best motion of the gripper."""
    from armdyn.experiments.gripper import motion_series
    from armdyn.experiments.rivals import undecided
    from pipeline.answers_motion import next_answer
    from pipeline.front import planned, rig_limits
    from pipeline.motion.offered import write_motion

    inputs = Inputs(model, runs, held_out, None, effects, trust_data)
    inputs.check(report, json_file)
    check_outputs(output, inputs=[model, *inputs.recordings])
    limits = rig_limits(travel, speed, acceleration, swing)
    motion_series(seconds)  # refuses a duration that no motion can have, before anything is fitted
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        named = [name.strip() for name in (rivals or "").split(",") if name.strip()]
        verdict, sentence, found = undecided(given.study, named if rivals is not None else None, say)
        made, offer = None, None
        if found is not None:
            made, offer = planned(found, seconds, limits, seed, say)
            sentence = " ".join([*([sentence] if sentence else []), made.sentence])
    written = output if offer is not None else None
    if offer is not None and output is not None:
        write_motion(offer, output)
    if report is not None:
        from pipeline.report.next_experiment import next_report

        next_report(made, sentence, command_line(), written if limits is None else None).write(report)
    if answered(json_file, lambda: next_answer(made, verdict, sentence, written)):
        _say(made, sentence)
        if written is not None:
            typer.echo(f"motion {written}")
            if limits is None:
                typer.echo(f"check it: armdyn check {written}")
                typer.echo(f"make it: armdyn trial --motion {written}")
        say_report(report)


def _say(made: "Plan | None", sentence: str) -> None:
    console = to_screen()
    console.print(sentence, markup=False)
    if made is None:
        return
    table = plain_table("experiment", "separation", "right verdict", "what to do")
    for p in made.proposals:
        table.add_row(
            p.experiment.kind, f"{p.outlook.separation:.1f} σ", f"{p.outlook.probability:.0%}", p.experiment.what
        )
    console.print(table)
    for pair in made.inseparable:
        console.print(f"no motion tells {' from '.join(pair.effects)}: {pair.why}.", markup=False, soft_wrap=True)
