"""`armdyn ik volume`: inverse kinematics over a grid of positions."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.output import JsonOption, write_json
from pipeline.commands.which_robot import (
    JointsOption,
    MeshesOption,
    RobotOption,
    ToolOption,
    UrdfOption,
    exactly,
    tool_rotation,
    which_robot,
)


def volume(
    low: Annotated[str, typer.Option(help="Lowest corner x,y,z in the base frame [m].")],
    high: Annotated[str, typer.Option(help="Highest corner x,y,z [m].")],
    out: Annotated[Path, typer.Option(help="The zarr directory; an interrupted build in it is continued.")],
    counts: Annotated[str, typer.Option(help="Targets along x, y and z.")] = "100,100,100",
    tool_rpy: Annotated[
        list[str] | None,
        typer.Option(
            help="The tool's roll, pitch, yaw [rad], several times for several; that of the line if not given."
        ),
    ] = None,
    robot: RobotOption = "baxter",
    urdf_file: UrdfOption = None,
    joints: JointsOption = None,
    tool: ToolOption = None,
    meshes: MeshesOption = True,
    processes: Annotated[int, typer.Option(min=1, help="Processes on this machine.")] = 2,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask scheduler, tcp://host:port, whose workers do it instead.")
    ] = None,
    collisions: Annotated[bool, typer.Option("--collisions", help="Check every posture for collisions.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Solve a grid of positions on one consistent branch, into a zarr directory."""
    import numpy as np
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from armdyn.errors import InputError
    from ik.volume import Grid, build_volume

    arm = which_robot(robot, urdf_file, joints, tool, meshes)
    sides = [round(count) for count in exactly(3, counts, "--counts")]
    if not tool_rpy and arm.given_line is None:
        raise InputError(f"--tool-rpy: robot '{arm.name}' has no line to take the tool's orientation from; give one")
    rotations = [tool_rotation(rpy) for rpy in tool_rpy] if tool_rpy else [arm.line.rotation]
    grid = Grid(
        np.array(exactly(3, low, "--low")),
        np.array(exactly(3, high, "--high")),
        (sides[0], sides[1], sides[2]),
        np.array(rotations),
    )
    columns = (TextColumn("targets"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("targets", total=grid.targets)
        done = build_volume(
            arm,
            grid,
            out,
            processes=processes,
            scheduler=scheduler,
            collisions=collisions,
            progress=lambda solved, total: bar.update(task, completed=solved, total=total),
        )
    answer = {
        "schema": "armdyn.volume/1",
        "robot": arm.name,
        "file": str(out),
        "targets": grid.targets,
        "solved": done.solved,
        "resumed": done.resumed,
        "seconds": done.seconds,
        "targets_per_second": done.solved / max(done.seconds, 1e-9),
        "reached": done.table.reached(),
        "neighbours_apart": done.table.apart(),
    }
    if json_file is not None:
        write_json(answer, json_file)
    if json_file != Path("-"):
        typer.echo(
            f"{grid.targets} targets, {done.solved} solved now in {done.seconds:.1f} s "
            f"({answer['targets_per_second']:.0f} per second), {done.resumed} were there\n"
            f"reached      {100 * done.table.reached():.2f} %\n"
            f"neighbours   {100 * done.table.apart():.4f} % of pairs are more than 0.2 rad apart\n"
            f"written to {out}"
        )
