"""The command `armdyn record`: record joint states, wrenches and load cell of a ROS robot as a run."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.console.options import ArmOption, CalibrationOption, JsonOption, RosOption, WrenchTopicOption
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import progress_display, screen_console, write_json_if_file_given

HELP_PANEL = "Experiments"


def record(
    ros: RosOption,
    output: Annotated[Path, typer.Option("--output", "--out", help="CSV file to write; a TOML file is written too.")],
    seconds: Annotated[float, typer.Option(min=0.1, help="Duration of the recording [s].")] = 30.0,
    arm: ArmOption = "baxter",
    wrench: WrenchTopicOption = None,
    loadcell: Annotated[
        str | None, typer.Option(help="Serial port of the load cell; by default no load cell is recorded.")
    ] = None,
    calibration: CalibrationOption = None,
    json_file: JsonOption = None,
) -> None:
    """Record joint states, wrenches and load cell of a ROS robot for 'compare' and 'repair'; it is not moved."""
    import urdf
    from pipeline.ros.record import record_run
    from pipeline.ros.topics import read_topics, settings_file
    from pipeline.ros.wrenches import chosen_wrench_topics

    check_outputs(output, json_file)
    with progress_display() as progress:
        run, said = record_run(
            ros,
            urdf.load(arm),
            read_topics(settings_file(arm)),
            output,
            seconds,
            loadcell,
            calibration,
            lambda share: progress("recording", share),
            chosen_wrench_topics(wrench or ()),
        )
    answer = {
        "schema": "armdyn.record/1",
        "output": str(output),
        "channels": {name: len(channel) for name, channel in run.channels.items()},
        "notes": list(said),
    }
    if write_json_if_file_given(json_file, lambda: answer):
        say = screen_console().print
        say(f"{output}: {len(run.channels)} channels, {max(map(len, run.channels.values()))} samples", soft_wrap=True)
        for note in said:
            say(note, soft_wrap=True, markup=False)
