"""`armdyn next`: which experiment tells apart what the runs so far do not."""

from collections.abc import Callable
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
    from armdyn.experiments.rivals import Rivals
    from armdyn.identify.study import Study

LOAD_RADIUS = 0.014
"""m; of the load, where nothing says otherwise."""


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
        Path | None, typer.Option(help="Where the designed motion goes: CSV along the robot's line.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the random motions from which the design starts.")] = 0,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Plan the next experiment: how well each kind tells rival effects apart, and the best motion of the gripper."""
    from armdyn.experiments.plan import plan
    from pipeline.answers_motion import next_answer
    from pipeline.motion.offered import arranged, write_motion

    inputs = Inputs(model, runs, held_out, None, effects, trust_data)
    inputs.check(report, json_file)
    check_outputs(output, inputs=[model, *inputs.recordings])
    harmonics_for(seconds)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        verdict, sentence, found = _rivals(given.study, rivals, say)
        made, offer = None, None
        if found is not None:
            made = plan(found, seconds, seed=seed, say=say)
            say("checking the motion on the whole arm")
            made, offer = arranged(made, LOAD_RADIUS)
            sentence = " ".join([*([sentence] if sentence else []), made.sentence])
    written = output if offer is not None else None
    if offer is not None and output is not None:
        write_motion(offer.trajectory, output)
    if report is not None:
        from pipeline.report.next_experiment import next_report

        next_report(made, sentence, command_line(), written).write(report)
    if answered(json_file, lambda: next_answer(made, verdict, sentence, written)):
        _say(made, sentence)
        if written is not None:
            typer.echo(f"motion {written}")
            typer.echo(f"check it: armdyn check {written}")
            typer.echo(f"make it: armdyn trial --motion {written}")
        say_report(report)


def harmonics_for(seconds: float) -> None:
    """Refuse a duration that no motion can have, before anything is fitted."""
    from armdyn.experiments.motion import Harmonics, Limits

    Harmonics(seconds, Limits())


def _rivals(study: "Study", names: str | None, say: Callable[[str], None]) -> "tuple[str, str, Rivals | None]":
    """Verdict and sentence of the diagnosis, and what is to be told apart; None where nothing is."""
    from armdyn.experiments.rivals import named, of_diagnosis, require_gripper, weakest
    from armdyn.identify.diagnose import diagnose

    require_gripper(study)
    if names is not None:
        return "", "", named(study, [name.strip() for name in names.split(",") if name.strip()])
    found = diagnose(study, say)
    rivals = of_diagnosis(study, found) or weakest(study, found)
    said = found.comparison.sentence if rivals is None else ""
    if rivals is None:
        said = f"{found.sentence} Nothing is left to be told apart, and all values are known well."
        if found.verdict.key == "unknown_effect":
            said = f"{found.sentence} No experiment can be designed for an effect that no model describes."
    return found.verdict.key, said, rivals


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
