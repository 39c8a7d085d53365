"""Joint states and load cell of a ROS robot as a run; nothing is sent to the robot."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

import urdf
from armdyn.channels import MIN_SAMPLES, Channel
from armdyn.errors import TaskFailedError
from armdyn.run import Run, write_run_csv
from pipeline.interrupts import noted_signals
from pipeline.loadcell.calibration import Calibration, default_path
from pipeline.loadcell.cell import LoadCell
from pipeline.robot.protocol import ForceSample, JointState
from pipeline.ros.bridge import Bridge, Message
from pipeline.ros.states import JointStates
from pipeline.ros.topics import RosTopics

SILENT = 1.0
"""Longest time between two joint states [s]: slower drivers shall be recorded too."""


def record_run(
    uri: str,
    arm: urdf.Robot,
    topics: RosTopics,
    output: Path,
    seconds: float,
    port: str | None = None,
    calibration: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[Run, tuple[str, ...]]:
    """Record for a while and write the run.

    Args:
        uri: of the bridge.
        arm: whose joints are recorded; where it has a line, its coordinate and height are too.
        topics: what the arm is called.
        output: the CSV file; its settings are written beside it.
        seconds: how long.
        port: serial port of the load cell; None where there is none.
        calibration: of the load cell; the user's own if not given.
        progress: told the share that is done.

    Returns:
        The run, which a signal may have ended early, and a sentence for everything that was left out.

    Raises:
        InputError: no bridge, no states of these joints, no load cell.
        TaskFailedError: what is recorded stopped coming; what came before is written.
    """
    states: list[JointState] = []
    forces: list[ForceSample] = []
    joints = JointStates(arm.joint_names)
    used = Calibration.load(calibration or default_path()) if port is not None else None
    with ExitStack() as stack:
        bridge = stack.enter_context(Bridge(uri))
        cell = stack.enter_context(LoadCell(port, used)) if port is not None and used is not None else None

        def take(message: Message, now: float) -> None:
            before = joints.latest
            joints.take(message, now)
            newest = joints.latest
            if newest is not None and newest is not before:
                states.append(newest)

        bridge.subscribe(topics.joint_states, "sensor_msgs/JointState", take)
        joints.first(topics.joint_states)
        start, ended = time.monotonic(), ""
        signals: list[int] = []
        stack.enter_context(noted_signals(signals.append))
        while not (ended or signals) and (elapsed := time.monotonic() - start) < seconds:
            time.sleep(min(0.05, seconds - elapsed))
            newest = joints.latest
            if bridge.failure is not None:
                ended = bridge.failure
            elif newest is not None and time.monotonic() - newest.time > SILENT:
                ended = f"{topics.joint_states}: nothing came for {SILENT:g} s"
            if cell is not None:
                forces += cell.read()
            if progress is not None:
                progress(elapsed / seconds)
        said = [*cell_notes(cell)]
    if joints.unreadable:
        said.append(f"{joints.unreadable} joint states were left out: a value was missing or not finite")
    kept = [state for state in states if state.time >= start]
    if len(kept) < MIN_SAMPLES:
        raise TaskFailedError(f"{ended or 'it was ended'}; {len(kept)} joint states came, too few to be written")
    run = _run(arm, kept, forces, start, output, used)
    write_run_csv(run, output)
    told = f"the {kept[-1].time - start:.1f} s of {seconds:g} s that came are in {output}"
    if ended:
        raise TaskFailedError(f"{ended}; {told}")
    if signals:
        said.append(f"ended by a signal; {told}")
    return run, tuple(said)


def cell_notes(cell: LoadCell | None) -> tuple[str, ...]:
    """A sentence per kind of fault that the load cell had."""
    if cell is None:
        return ()
    return tuple(f"load cell, {count} times: {fault.value}" for fault, count in cell.status().counts.items() if count)


def _run(
    arm: urdf.Robot,
    kept: list[JointState],
    forces: list[ForceSample],
    start: float,
    output: Path,
    calibration: Calibration | None,
) -> Run:
    """The channels of the contract; times count from `start` [s]."""
    time_of_states = np.array([state.time - start for state in kept])
    channels: dict[str, Channel] = {}
    for prefix, unit, rows in (
        ("q", "rad", [state.q for state in kept]),
        ("v", "rad/s", [state.v for state in kept]),
        ("tau", "N m", [state.tau for state in kept]),
    ):
        values = np.array(rows)
        for column, name in enumerate(arm.joint_names):
            channels[f"{prefix}.{name}"] = Channel(time_of_states, values[:, column], unit)
    if forces:
        if arm.given_line is not None:
            along = np.array([arm.line.coordinates(arm.tool_pose(state.q).translation) for state in kept])
            channels["gripper_x"] = Channel(time_of_states, along[:, 0], "m")
            channels["gripper_z"] = Channel(time_of_states, along[:, 1], "m")
        late = [sample for sample in forces if sample.time >= start]
        channels["load_force"] = Channel(
            np.array([sample.time - start for sample in late]), np.array([sample.force for sample in late]), "N"
        )
    noise = {"load_force": calibration.noise} if calibration is not None and forces else {}
    description = f"recorded from ROS, robot {arm.name}"
    return Run(output.name, channels, {}, noise, description, output)
