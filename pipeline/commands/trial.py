"""`armdyn trial`: one whole experiment."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.errors import InputError
from pipeline.console.options import EffectsOption, JsonOption, parse_hidden, quantity
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import Say, spinner
from pipeline.console.trial_result import conclude_trial, real_trial

if TYPE_CHECKING:
    from armdyn.pendulum.model import PendulumModel
    from pipeline.motion.trajectory import LineTrajectory
    from pipeline.trial import SimulatedTrial, TrialSettings

PANEL = "Experiments"


def trial(
    length_guess: Annotated[
        float | None, typer.Option(help="What the robot believes at first [m]; 0.328, or the model's length.")
    ] = None,
    length: Annotated[
        float, typer.Option(help="The true length in the simulation, pivot to the load's centre [m].")
    ] = 0.368,
    no_estimation: Annotated[bool, typer.Option("--no-estimation", help="Plan with the guess, learn nothing.")] = False,
    hidden: Annotated[
        list[str] | None,
        typer.Option(
            help="EFFECT or EFFECT=VALUE that the simulated robot has and the model does not know; FILE.py:EFFECT of "
            "your own."
        ),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Model file for estimator, control and planner, such as a repaired one.")
    ] = None,
    effects: EffectsOption = None,
    seed: Annotated[int, typer.Option(help="Of everything random in the simulation.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            help="Directory for the recording and the report; out/trial, or out/trial-2 where one is running.",
        ),
    ] = None,
    picture: Annotated[bool, typer.Option("--picture", help="Render the swing: swing.png and swing.gif.")] = False,
    mass: Annotated[str, typer.Option(help="Of the load, as weighed.")] = "80 g +/- 0.8 g",
    robot: Annotated[
        str, typer.Option(help="'simulated', or a driver and where the robot is: ros:ws://HOST:9090, its rosbridge.")
    ] = "simulated",
    ros: Annotated[str | None, typer.Option("--ros", help="With --robot ros: its rosbridge, ws://HOST:9090.")] = None,
    arm: Annotated[
        str,
        typer.Option("--arm", help="With a real robot: a known arm, or a settings file with its driver's table."),
    ] = "baxter",
    loadcell: Annotated[str | None, typer.Option(help="With a real robot: serial port of the load cell.")] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Of the load cell, by 'armdyn loadcell calibrate'; your settings if not given.")
    ] = None,
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="With a real robot: only move along the line, slowly, without a load.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With a real robot: move without asking, for scripts.")] = False,
    landed: Annotated[
        str | None, typer.Option(help="With a real robot: whether the load landed, 'yes' or 'no'; else you are asked.")
    ] = None,
    investigate: Annotated[
        int,
        typer.Option(
            "--investigate",
            metavar="N",
            help="First find out what the model lacks, by at most so many experiments, each designed from the last.",
        ),
    ] = 0,
    motion: Annotated[
        Path | None, typer.Option(help="Learn along this motion, of 'armdyn next', in place of the one SAC chooses.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Learn the string's length, plan the swing, put the load into the box."""
    from pipeline.trial import ProtocolSettings, TrialSettings
    from pipeline.trial.folder import own_folder

    check_outputs(json_file)
    given = _pendulum(model, effects) if model else None
    guess = length_guess if length_guess is not None else given.value("length") if given else 0.328
    held = given is not None and not given.parameters["length"].fitted
    estimate = not (no_estimation or held)
    note = f"{model} holds the length fixed: it was not estimated" if held and not no_estimation else ""
    known = quantity(mass, "kg", "--mass")
    weighed, weighed_std = known.value, known.std or 0.01 * known.value
    if investigate < 0:
        raise InputError(f"--investigate {investigate}: give the number of experiments, such as 4")
    if (investigate or motion) and not estimate:
        raise InputError("--investigate and --motion: need an estimate; leave out --no-estimation")
    along = _motion(motion) if motion is not None else None
    if robot != "simulated":
        for option, unused in (("--hidden", hidden), ("--picture", picture)):
            if unused:
                raise InputError(f"{option}: only the simulated robot has it; leave it out, or leave out --robot")
        if robot == "ros" and ros is None:
            raise InputError("--robot ros: say where it is: --ros ws://HOST:9090")
        protocol = ProtocolSettings(
            length_guess=guess, estimate=estimate, model=given, mass=weighed, mass_std=weighed_std,
            motion=along, investigate=investigate,
        )  # fmt: skip
        with own_folder(out, Path("out/trial")) as folder:
            real_trial(protocol, robot, ros, arm, loadcell, calibration, folder, rehearse, yes, landed, json_file, note)
        return
    for option, text in (("--ros", ros), ("--loadcell", loadcell), ("--landed", landed), ("--rehearse", rehearse)):
        if text:
            raise InputError(f"{option}: needs a real robot, such as --robot ros")
    settings = TrialSettings(
        length_guess=guess, length=length, estimate=estimate, hidden=parse_hidden(hidden or []), model=given,
        seed=seed, mass=weighed, mass_std=weighed_std, motion=along, investigate=investigate,
    )  # fmt: skip
    with own_folder(out, Path("out/trial")) as folder:
        _run(replace(settings, out=folder), folder, json_file, note, picture=picture)


def _run(settings: "TrialSettings", out: Path, json_file: Path | None, note: str, *, picture: bool) -> None:
    """Run one trial in a folder that no other process writes to, and print its result."""
    from pipeline.trial import simulate

    with spinner() as progress:
        done = simulate(settings, progress)

    def draw(show: Say) -> tuple[Path, ...]:
        return _render(done, out, show) if picture else ()

    known = f"true {settings.length:g} m, "
    conclude_trial(done, out, json_file, done.result.as_json(), (), known=known, note=note, draw=draw)


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


def _render(done: "SimulatedTrial", out: Path, show: Say) -> tuple[Path, ...]:
    """Draw the swing; returns the files that were written."""
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
