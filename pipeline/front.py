"""Functions for scripts that need a robot or a file format: import a log, export a model, check or design a motion."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.checked_study import AnyModel, CheckedStudy, Runs, Say, model_file_of
from armdyn.errors import InputError, TaskFailedError

if TYPE_CHECKING:
    from armdyn.effects.effect import Effect
    from armdyn.experiments.limits import GripperLimits
    from armdyn.experiments.plan import ExperimentPlan
    from armdyn.experiments.rivals import Rivals
    from armdyn.pendulum.path import GripperPath
    from armdyn.run import Run
    from pipeline.motion.excitation import Excitation
    from pipeline.motion.feasibility import FeasibilityReport


def import_log(
    file: str | Path,
    *,
    mapping: str | Path | None = None,
    urdf: str | Path | None = None,
    commands: str | Path | None = None,
    drives: Sequence[str] = (),
    rate: float | None = None,
) -> "list[Run]":
    """Convert a recording of another program to runs: tables, bags, Parquet, MATLAB, LeRobot data sets.

    Args:
        file: the recording.
        mapping: TOML file that says which column is which channel; ``armdyn import FILE --guess`` proposes one. By
            default the columns' names must be unambiguous.
        urdf: description of the robot, whose names of joints are used.
        commands: a second file, with the commands of the joints and stamps of its own.
        drives: servos whose raw registers the columns are, such as ``"sts3215=all"``.
        rate: rows per second of a table without stamps [Hz].

    Returns:
        One run, or a run for each episode of a data set and each entry ``[runs.NAME]`` of the mapping.

    Raises:
        InputError: the file cannot be read, or it is uncertain what a column is; the message says what to do.
    """
    from pipeline.imports import read_foreign
    from pipeline.imports.conversion import runs_from_recordings
    from pipeline.imports.joints import RobotJoints
    from pipeline.imports.mapping import read_map
    from pipeline.imports.register_entries import DriveKinds
    from urdf import load

    return [
        each.run
        for each in runs_from_recordings(
            read_foreign(Path(file)),
            None if mapping is None else read_map(Path(mapping)),
            None if urdf is None else RobotJoints.of(load(urdf, meshes=False)),
            DriveKinds.of(drives),
            None if commands is None else read_foreign(Path(commands)),
            "" if rate is None else f"{rate:.12g} Hz",
        )
    ]


def export(
    model: AnyModel, path: str | Path, *, force: bool = False, incomplete: bool = False, named_only: bool = False
) -> tuple[str, ...]:
    """Write a model to a file for another program.

    Args:
        model: the model or a repair, or its file.
        path: file to write; its ending selects the format: ``.urdf``, ``.xml`` (MuJoCo's), ``.c``, ``.py`` or
            ``.json``.
        force: replace an existing file.
        incomplete: write the file even if the format cannot contain much of what a repair found.
        named_only: leave out the model's background, the smooth force that belongs to no named effect.

    Returns:
        One sentence for each part of the model that the format cannot contain.

    Raises:
        InputError: the file exists, its ending belongs to no format, or the format cannot contain this kind of model.
        TaskFailedError: the file would lack much of what a repair added.
    """
    from pipeline.console.outputs import check_overwrite
    from pipeline.exports import write_export

    output = Path(path)
    file = model_file_of(model)
    file = replace(file, model=file.model.with_named_effects_only()) if named_only else file
    check_overwrite(output, force)
    written = write_export(file, output, str(file.model.base_summary), incomplete=incomplete)
    if written.refused and written.missing is not None:
        sentence = written.missing.sentence
        raise TaskFailedError(f"{output}: not written, {sentence}: give incomplete=True to write it all the same")
    return written.notes


def excite(
    model: AnyModel,
    effects: Sequence[str] = (),
    *,
    rivals: tuple[str, str] | None = None,
    seconds: float = 20.0,
    rate: float = 100.0,
    random: int = 100,
    seed: int = 0,
) -> "Excitation":
    """Design the motion of an arm that determines the parameters of effects best, or distinguishes two effects.

    `Excitation.motion` is the motion as a run.

    Args:
        model: model of the arm, or its file.
        effects: effects to determine, such as ``"payload"`` or ``"rotor_inertia:elbow,wrist"``; by default friction,
            offsets and inertias.
        rivals: names of two effects to distinguish, in place of `effects`.
        seconds: duration of the motion [s].
        rate: samples per second [Hz].
        random: number of random motions from which the design starts.
        seed: seed of the random motions.

    Raises:
        InputError: the model is not that of an arm, or an effect cannot act on the arm.
        UnknownNameError: an effect or joint does not exist.
        TaskFailedError: no feasible motion was found.
    """
    from armdyn.arm.model import required_arm
    from armdyn.effects.catalogue import find
    from armdyn.experiments.goal import goal_to_determine, goal_to_separate
    from pipeline.motion.excitation import design_excitation

    arm = required_arm(model_file_of(model).model, "a motion is designed", "give an arm's").without_background()
    if rivals is None:
        goal = goal_to_determine(arm, [find(name) for name in effects], rate)
    else:
        goal = goal_to_separate(arm, find(rivals[0]), find(rivals[1]), rate)
    return design_excitation(goal, seconds, random=random, compare=False, seed=seed)


def check(model: AnyModel, trajectory: "Run | str | Path", *, retime: bool = False) -> "tuple[FeasibilityReport, Run]":
    """Check a motion on an arm as its model describes it, before the arm moves.

    Args:
        model: the arm's model or a repair, or its file. The band of the torques contains the errors of a repair, or of
            the last one that a file contains; of a model in memory only the standard deviations of its values.
        trajectory: the motion, or its file; with `retime` also a file of waypoints without times, or a JSON trajectory
            of ROS.
        retime: whether to retime the path to the fastest feasible speed first.

    Returns:
        The report, and the motion that was checked.

    Raises:
        InputError: a file cannot be used.
        TaskFailedError: no speed is feasible.
    """
    from armdyn.run import Run
    from pipeline.motion.feasibility import CheckSettings, check_joints
    from pipeline.motion.feasibility.as_modelled import ModelledArm
    from pipeline.motion.feasibility.check import joint_position_units
    from pipeline.motion.feasibility.read import read_trajectory, read_waypoints
    from pipeline.motion.retime import retimed_on_arm
    from pipeline.motion.trajectory import LineTrajectory

    arm = ModelledArm.of_file(model_file_of(model))
    robot, settings = arm.model.robot, CheckSettings(min_singular_value=0.0, modelled=arm)
    if retime:
        motion = retimed_on_arm(robot, *read_waypoints(trajectory, robot), settings)
    else:
        read = read_trajectory(trajectory, robot)
        if isinstance(read, LineTrajectory):
            raise InputError(f"{trajectory}: a motion along the line: use 'armdyn check --model'")
        motion = read
    return check_joints(robot, motion, settings), Run("motion", motion.channels(joint_position_units(robot)))


def next_experiment(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    *,
    rivals: Sequence[str] | None = None,
    seconds: float | None = None,
    inputs: Mapping[str, tuple[float, float]] | None = None,
    travel: float | None = None,
    speed: float | None = None,
    acceleration: float | None = None,
    swing: float | None = None,
    effects: "Iterable[Effect] | None" = None,
    seed: int = 0,
) -> "ExperimentPlan":
    """Plan the experiment that best distinguishes effects between which the recordings cannot decide.

    The plan contains the best motion of the gripper, or for a base of one's own signals for its inputs.

    Args:
        model: model of a pendulum or of a base of one's own, or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that help to choose effects, but are never fitted.
        rivals: names of effects to distinguish; by default those between which the diagnosis cannot decide.
        seconds: duration of the designed motion or signal [s]; None for 8 s, or of a base of one's own for that of the
            last recording.
        inputs: least and largest value of inputs of a base of one's own, in their units; by default the range of the
            recordings.
        travel: largest distance of the gripper from the middle of the line [m], if the robot is not Baxter.
        speed: largest speed of the gripper [m/s], if the robot is not Baxter.
        acceleration: largest acceleration of the gripper [m/s^2], if the robot is not Baxter.
        swing: largest angle of the load from the vertical [rad], if the robot is not Baxter.
        effects: effects to choose from; by default those of the catalogue and of the base model.
        seed: seed of the random motions.

    Raises:
        InputError: a file cannot be read, the runs cannot be compared with the model, or no gripper moves in them.
        TaskFailedError: there are no effects to distinguish.
    """
    from armdyn.experiments.rivals import rivals_of_study

    _, sentence, found = rivals_of_study(CheckedStudy.of(model, runs, held_out, effects=effects).study, rivals)
    if found is None:
        raise TaskFailedError(sentence)
    limits = user_given_gripper_limits(travel, speed, acceleration, swing)
    return plan_experiment(found, seconds, limits, inputs or {}, seed)[0]


def user_given_gripper_limits(
    travel: float | None, speed: float | None, acceleration: float | None, swing: float | None
) -> "GripperLimits | None":
    """Limits of a gripper's motion from those that the user gave; None if none was given and the robot is Baxter.

    Args:
        travel: largest distance from the middle of the line [m].
        speed: largest speed [m/s].
        acceleration: largest acceleration [m/s^2].
        swing: largest angle of the load from the vertical [rad].

    Raises:
        InputError: a limit is not positive.
    """
    from armdyn.experiments.limits import GripperLimits

    given = {"travel": travel, "speed": speed, "acceleration": acceleration, "swing": swing}
    known = {name: value for name, value in given.items() if value is not None}
    return GripperLimits(**known) if known else None


def plan_experiment(
    rivals: "Rivals",
    seconds: float | None,
    limits: "GripperLimits | None",
    inputs: Mapping[str, tuple[float, float]],
    seed: int = 0,
    say: Say = lambda _: None,
) -> "tuple[ExperimentPlan, GripperPath | Run | None]":
    """Plan an experiment that distinguishes rival effects, and design the gripper's motion or signals for inputs.

    Args:
        rivals: effects to distinguish, as hypotheses.
        seconds: duration of the motion or the signal [s]; None for the usual one.
        limits: limits of the gripper's motion; None for Baxter, whose whole arm is checked.
        inputs: least and largest value of inputs of a base of one's own; by default those of the last recording.
        seed: seed of the random motions and signals.
        say: function that is called with a sentence about each step.

    Returns:
        The plan, and the motion, or a run with the inputs of the best experiment; None where none would be useful.
    """
    from armdyn.experiments.plan import (
        MIN_RIGHT_VERDICT_PROBABILITY,
        USUAL_MOTION_SECONDS,
        plan_experiment,
        plan_process_experiment,
    )
    from armdyn.experiments.process import input_ranges, process_experiments
    from pipeline.box import LOAD_RADIUS
    from pipeline.motion.feasible_motion import with_feasible_motion

    if rivals.of_process:
        driving = [name for name in rivals.hypotheses[0].model.inputs if name in rivals.last.channels]
        ranges = input_ranges([rivals.last], driving, inputs)
        made = plan_process_experiment(rivals, process_experiments(rivals, ranges, seconds, seed), seed, say)
        first = made.proposals[0] if made.proposals else None
        if first is None or first.experiment.recording is None or not driving:
            return made, None
        if first.expected.probability <= MIN_RIGHT_VERDICT_PROBABILITY:
            return made, None
        run = first.experiment.recording
        return made, replace(run, channels={name: run.channels[name] for name in driving})
    if inputs:
        raise InputError(
            f"--input {next(iter(inputs))}: a gripper moves in these runs: limit it with --travel, --speed"
        )
    made = plan_experiment(rivals, USUAL_MOTION_SECONDS if seconds is None else seconds, limits, seed=seed, say=say)
    if limits is None and made.motion is not None:
        say("checking the motion on the whole arm")
        made, offer = with_feasible_motion(made, LOAD_RADIUS)
        return made, offer.motion if offer is not None else None
    moving = made.motion
    useful = moving is not None and moving.expected.probability > MIN_RIGHT_VERDICT_PROBABILITY
    return made, moving.experiment.motion if moving is not None and useful else None
