"""The command `armdyn twin`: run a simulated Baxter that uses the ROS topics of the real one."""

from pathlib import Path
from typing import Annotated

import typer

from armdyn.errors import TaskFailedError
from pipeline.console.options import JsonOption, RosOption, SecondsOption, parse_hidden_effects, parse_number_list
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import write_json

HELP_PANEL = "Experiments"


DEFAULT_TWIN_STRING_LENGTH = 0.368
"""Default of the true length in the simulation, from the pivot to the load's centre [m]."""


def twin(
    ros: RosOption,
    hidden: Annotated[
        list[str] | None,
        typer.Option(
            help="EFFECT or EFFECT=VALUE that the simulated robot has and models lack; FILE.py:EFFECT for your own."
        ),
    ] = None,
    length: Annotated[
        float, typer.Option(help="True length of the string, from the pivot to the load's centre [m].")
    ] = DEFAULT_TWIN_STRING_LENGTH,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the simulation.")] = 0,
    start: Annotated[
        str | None,
        typer.Option(help="Joint positions at the start [rad], separated by commas; by default the line's middle."),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="File to write, the calibration of the simulated load cell for 'armdyn trial'.")
    ] = None,
    seconds: SecondsOption = None,
    json_file: JsonOption = None,
) -> None:
    """Run a simulated Baxter in real time, with the ROS topics of the real one and a load cell on a pseudo-terminal."""
    import time
    from dataclasses import replace

    import numpy as np

    import ik
    import urdf
    from pipeline.interrupts import deferred_signals
    from pipeline.robot.settings import PlantSettings
    from pipeline.ros.topics import read_topics, settings_file
    from pipeline.ros.twin import SimulatedBaxterOnRos

    check_outputs(json_file, calibration)
    arm = urdf.load("baxter")
    posture = ik.default_table(arm).posture(0.0).q
    if start is not None:
        posture = np.array(parse_number_list(len(arm.joint_names), start, "--start"))
    plant = replace(PlantSettings(), length=length)
    ends: list[int] = []
    topics = read_topics(settings_file("baxter"))
    with SimulatedBaxterOnRos(ros, arm, topics, posture, plant, parse_hidden_effects(hidden or []), seed) as robot:
        if calibration is not None:
            robot.calibration.save(calibration)
        typer.echo(f"loadcell {robot.port.port}")
        typer.echo("READY")
        end = None if seconds is None else time.monotonic() + seconds
        with deferred_signals(ends.append):
            robot.run(
                lambda: bool(ends) or robot.bridge.failure is not None or (end is not None and time.monotonic() >= end)
            )
        lost = robot.bridge.failure
        answer = robot.summary()
    if json_file is not None:
        write_json(answer, json_file)
    if lost is not None:
        raise TaskFailedError(f"{lost}; the twin has ended")
