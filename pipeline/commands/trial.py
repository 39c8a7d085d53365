"""The command `armdyn trial`: one whole experiment, in which the robot swings a load into a box."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.errors import InputError
from pipeline.console.options import EffectsOption, JsonOption, parse_hidden_effects, parse_option_quantity
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import ProgressDisplay, progress_display
from pipeline.console.trial_result import RobotOptions, real_trial, report_and_save_trial

if TYPE_CHECKING:
    from armdyn.pendulum.model import PendulumModel
    from pipeline.motion.trajectory import LineTrajectory
    from pipeline.trial import SimulatedTrial

HELP_PANEL = "Experiments"


def trial(
    length_guess: Annotated[
        float | None,
        typer.Option(help="First guess of the string's length [m]; by default 0.328, or the length in the model."),
    ] = None,
    length: Annotated[
        float, typer.Option(help="True length in the simulation, from the pivot to the load's centre [m].")
    ] = 0.368,
    no_estimation: Annotated[
        bool, typer.Option("--no-estimation", help="Plan with the guess, without estimating the length.")
    ] = False,
    hidden: Annotated[
        list[str] | None,
        typer.Option(
            help="EFFECT or EFFECT=VALUE that the simulated robot has and the model lacks; FILE.py:EFFECT for your own "
            "effect."
        ),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Model file for estimator, control and planner, such as a repaired one.")
    ] = None,
    effects: EffectsOption = None,
    seed: Annotated[int, typer.Option(help="Random seed of the simulation.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            help="Directory for recording and report; by default out/trial, or out/trial-2 if a trial is running.",
        ),
    ] = None,
    picture: Annotated[bool, typer.Option("--picture", help="Render the swing: swing.png and swing.gif.")] = False,
    mass: Annotated[str, typer.Option(help="Measured mass of the load.")] = "80 g +/- 0.8 g",
    *,
    link: RobotOptions,
    investigate: Annotated[
        int,
        typer.Option(
            "--investigate",
            metavar="N",
            help="First find out what the model lacks, by at most N experiments, each designed from those before.",
        ),
    ] = 0,
    motion: Annotated[
        Path | None,
        typer.Option(help="Motion to estimate the length, from 'armdyn next', in place of the one that SAC chooses."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Estimate the string's length, plan the swing, and put the load into the box."""
    from pipeline.trial import TrialSettings, simulate_trial
    from pipeline.trial.folder import locked_folder

    check_outputs(json_file)
    given = _pendulum(model, effects) if model else None
    guess = length_guess if length_guess is not None else given.value("length") if given else 0.328
    held = given is not None and not given.parameters["length"].fitted
    estimate = not (no_estimation or held)
    note = f"{model} holds the length fixed: it was not estimated" if held and not no_estimation else ""
    weighed = parse_option_quantity(mass, "kg", "--mass")
    if investigate < 0:
        raise InputError(f"--investigate {investigate}: give the number of experiments, such as 4")
    if (investigate or motion) and not estimate:
        raise InputError("--investigate and --motion: need an estimate; leave out --no-estimation")
    along = _motion(motion) if motion is not None else None
    link.check({"--hidden": hidden, "--picture": picture})
    settings = TrialSettings(
        length_guess=guess, true_length=length, estimate=estimate, model=given, mass=weighed.value,
        mass_std=weighed.std or 0.01 * weighed.value, motion=along, investigate=investigate,
        hidden=parse_hidden_effects(hidden or []), seed=seed,
    )  # fmt: skip
    with locked_folder(out, Path("out/trial")) as folder:
        if link.robot != "simulated":
            real_trial(settings, link, folder, json_file, note)
            return
        with progress_display() as progress:
            done = simulate_trial(replace(settings, out=folder), progress)
        report_and_save_trial(
            done,
            folder,
            json_file,
            done.result.as_json(),
            known=f"true {length:g} m, ",
            note=note,
            draw=lambda show: _render(done, folder, show) if picture else (),
        )


def _motion(file: Path) -> "LineTrajectory":
    import urdf
    from pipeline.motion.feasibility.read import read_trajectory
    from pipeline.motion.trajectory import LineTrajectory

    found = read_trajectory(file, urdf.load("baxter"))
    if not isinstance(found, LineTrajectory):
        raise InputError(f"{file}: is a motion of the joints; give one along the line, with a column 's [m]'")
    return found


def _pendulum(file: Path, effects: Path | None) -> "PendulumModel":
    from armdyn.effects.user import load_effects
    from armdyn.model_file import read_model
    from armdyn.pendulum.model import PendulumModel

    model = read_model(file, load_effects(effects))
    if not isinstance(model, PendulumModel):
        raise InputError(f"{file}: a trial needs a pendulum; this is a model of base '{model.base}'")
    return model


def _render(done: "SimulatedTrial", out: Path, show: ProgressDisplay) -> tuple[Path, ...]:
    from pipeline.robot.picture import render_swing

    history = done.swing_history()
    if history is None:
        return ()
    files = (out / "swing.png", out / "swing.gif")
    for file in files:
        show(f"{file.name}: the robot's shapes", 0.0)  # loading the meshes takes as long as drawing several pictures

        def drawn(count: int, total: int, name: str = file.name) -> None:
            show(f"{name}: {count} of {total} drawn", count / total)

        render_swing(done.experiment.description, done.robot.settings, history, file, progress=drawn)
    return files
