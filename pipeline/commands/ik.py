"""The command `armdyn ik`: compute the inverse kinematics of paths and volumes, and search for a line."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.errors import InputError
from pipeline.console.options import (
    ArmChoice,
    ArmModelOption,
    JsonOption,
    parse_number_list,
    parse_numbers,
    tool_rotation,
)
from pipeline.console.screen import finish_command, write_json_if_file_given
from pipeline.fields import attributes_as_json

if TYPE_CHECKING:
    from ik import PathTable
    from ik.search import LineCandidate, LineRequirements

HELP_PANEL = "Motions of an arm"


def volume(
    low: Annotated[str, typer.Option(help="Lowest corner x,y,z of the volume in the base frame [m].")],
    high: Annotated[str, typer.Option(help="Highest corner x,y,z of the volume in the base frame [m].")],
    out: Annotated[
        Path,
        typer.Option("--out", "--output", help="The zarr directory to write; an interrupted build in it is continued."),
    ],
    choice: ArmChoice,
    counts: Annotated[str, typer.Option(help="Number of targets along x, y and z.")] = "100,100,100",
    tool_rpy: Annotated[
        list[str] | None,
        typer.Option(
            help="The tool's roll, pitch, yaw [rad]; may be repeated for several orientations; by default that of the "
            "robot's line."
        ),
    ] = None,
    processes: Annotated[int, typer.Option(min=1, help="Number of processes on this computer.")] = 2,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask scheduler, tcp://host:port, whose workers compute instead.")
    ] = None,
    collisions: Annotated[bool, typer.Option("--collisions", help="Check every posture for collisions.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Compute the inverse kinematics on a 3-D grid, with postures that vary smoothly, into a zarr directory."""
    import numpy as np
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ik.volume import TargetGrid, build_volume

    arm = choice.load()
    sides = [round(count) for count in parse_number_list(3, counts, "--counts")]
    if not tool_rpy and arm.line_or_none is None:
        raise InputError(f"--tool-rpy: robot '{arm.name}' has no line to take the tool's orientation from; give one")
    rotations = [tool_rotation(rpy) for rpy in tool_rpy] if tool_rpy else [arm.line.rotation]
    grid = TargetGrid(
        np.array(parse_number_list(3, low, "--low")),
        np.array(parse_number_list(3, high, "--high")),
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
        "reached": done.table.reached_share(),
        "neighbours_apart": done.table.discontinuity_share(),
    }
    if write_json_if_file_given(json_file, lambda: answer):
        typer.echo(
            f"{grid.targets} targets, {done.solved} solved now in {done.seconds:.1f} s "
            f"({answer['targets_per_second']:.0f} per second), {done.resumed} solved before\n"
            f"reached      {100 * done.table.reached_share():.2f} %\n"
            f"neighbours   {100 * done.table.discontinuity_share():.4f} % of pairs are more than 0.2 rad apart\n"
            f"written to {out}"
        )


group = typer.Typer(
    help="Compute tables of inverse kinematics and Jacobians along lines and paths and in volumes.",
    no_args_is_help=True,
)
group.command()(volume)


@group.command()
def build(
    choice: ArmChoice,
    path: Annotated[
        Path | None,
        typer.Option(help="A path file (TOML: line, circle or spline), in place of the line in the robot's settings."),
    ] = None,
    search: Annotated[
        bool,
        typer.Option("--search", help="First search for a line: fast, far from joint limits, without collisions."),
    ] = False,
    extent: Annotated[str, typer.Option(help="With --search: first and last line coordinate [m].")] = "-0.25,0.25",
    core: Annotated[
        str, typer.Option(help="With --search: first and last coordinate of the part where speed matters most [m].")
    ] = "-0.15,0.15",
    direction: Annotated[str, typer.Option(help="With --search: direction of the line in the base frame.")] = "0,1,0",
    tool_rpy: Annotated[
        str | None,
        typer.Option(
            help="With --search: the tool's roll, pitch, yaw [rad]; by default parallel to the base's axes, nearest to "
            "the tool's at home."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "--output", help="File of the table; by default, for the line in a robot's settings, the cache."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Build the IK table of the line in a robot's settings, of a path, or of a line that is searched for."""
    from ik.build import build_line_table, build_path_table, default_table_path
    from ik.pathfile import read_path
    from ik.search import search_line
    from pipeline.report.ik import ik_document

    if search and path is not None:
        raise InputError("--search and --path exclude each other; choose one")
    arm = choice.load()
    target, found = out, None
    table: PathTable
    if search:
        found = search_line(arm, _requirements(extent, core, direction, tool_rpy), progress=_say)
        arm = replace(arm, home=found.home, line_or_none=found.line)
        table = build_line_table(arm, progress=_say)
    elif path is not None:
        if target is None:
            raise InputError("--path: the cache keeps only a robot's own line; say where to write the table with --out")
        table = build_path_table(arm, read_path(path), progress=_say)
    else:
        table = build_line_table(arm, progress=_say)
        target = target or default_table_path(arm)
    if target is not None:
        table.save(target)
    extra: dict[str, Any] = {} if target is None else {"file": str(target)}
    written = [] if found is None else [line_settings_text(found)]
    written += [] if target is None else [f"written to {target}"]
    if found is not None:
        quality = attributes_as_json(found, "home core_speed whole_speed joint_margin clearance torque")
        extra["found"] = {"line": found.line.describe(), **quality}
    finish_command(ik_document(table), lambda: table_json(table) | extra, json_file, written=written)


@group.command()
def show(
    file: Annotated[Path, typer.Argument(help="A table that 'armdyn ik build' wrote.")],
    model: ArmModelOption = None,
    json_file: JsonOption = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML file to write, with curves of the joints, their margins and limits.")
    ] = None,
) -> None:
    """Show the content of an IK table."""
    from ik import PathTable
    from pipeline.report.ik import ik_document, ik_report
    from urdf import known_robots, load

    table, arm = PathTable.load(file), None
    if model is not None:
        arm = ArmChoice(model=model).load()
        table = PathTable.load(file, arm)
    elif table.robot_name in known_robots():
        arm = load(table.robot_name)
        table = PathTable.load(file, arm)
    finish_command(ik_document(table), lambda: table_json(table), json_file, report, lambda: ik_report(table, arm))


@group.command()
def look(
    file: Annotated[Path, typer.Argument(help="A table that 'armdyn ik build' wrote.")],
    at: Annotated[str, typer.Option("--at", help="Path coordinates s1,s2,... [m] at which the table is read.")],
    speed: Annotated[float, typer.Option(help="Speed of the tool along the path there [m/s].")] = 0.0,
    json_file: JsonOption = None,
) -> None:
    """Read postures, joint velocities, Jacobians and limits from an IK table at any places of its path."""
    import numpy as np

    from ik import load
    from pipeline.report.ik import look_document

    table, s = load(file), np.array(parse_numbers(at, "--at"))
    posture = table.posture(s)
    motion = table.joint_motion(s, np.full(len(s), speed), np.zeros(len(s)))
    arrays = {
        "s": s, "q": posture.q, "dq_ds": posture.dq_ds, "d2q_ds2": posture.d2q_ds2, "jacobian": table.jacobian_at(s),
        "v": motion.v, "a": motion.a, "speed_limit": table.speed_limit_at(s),
        "acceleration_limit": table.acceleration_limit_at(s),
        "torque_acceleration_range": np.stack(table.torque_acceleration_range(s, speed), axis=1),
    }  # fmt: skip
    answer = {"schema": "armdyn.ik_look/1", "joints": table.joint_names, **{k: v.tolist() for k, v in arrays.items()}}
    finish_command(look_document(table, s, motion), lambda: answer, json_file)


def _say(stage: str) -> None:
    typer.echo(f"{stage} ...", err=True)


def _requirements(extent: str, core: str, direction: str, tool_rpy: str | None) -> "LineRequirements":
    from ik.search import LineRequirements

    first, last = parse_number_list(2, extent, "--extent")
    low, high = parse_number_list(2, core, "--core")
    x, y, z = parse_number_list(3, direction, "--direction")
    if not first <= low < high <= last:
        raise InputError(f"--core: {core} m does not lie within --extent {extent} m; give low,high inside it")
    if not abs(x) + abs(y) + abs(z) > 0:
        raise InputError("--direction: 0,0,0 points nowhere; give another")
    rotation = None if tool_rpy is None else tool_rotation(tool_rpy)
    return LineRequirements(direction=(x, y, z), rotation=rotation, s_min=first, s_max=last, core=(low, high))


def table_json(table: "PathTable") -> dict[str, Any]:
    """JSON output ``armdyn.ik/1`` of an IK table; the tool's poses in it are those of the path."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    rotation, position = table.path.pose(table.s)
    return {
        "schema": "armdyn.ik/1",
        **attributes_as_json(
            table,
            "robot=robot_name joints=joint_names tool_link=tool_frame tool_offset s q dq_ds tool_position= "
            "tool_quaternion= speed_limit joint_margin path= acceleration_limit torque_acceleration_range= "
            "torque_share margin= manipulability",
            tool_position=position.T,
            tool_quaternion=Rotation.from_matrix(np.array(rotation.transpose(2, 0, 1))).as_quat(),
            path=table.path.describe(),
            torque_acceleration_range=np.stack(table.torque_acceleration_range(table.s), axis=1),
            margin=table.margin.min(axis=1),
        ),
    }


def line_settings_text(found: "LineCandidate") -> str:
    """Text of a line that was searched for, as the tables ``[line]`` and ``[arm]`` of a robot's settings file."""
    import pinocchio as pin

    line = found.line
    entries = {
        "origin": line.origin,
        "direction": line.direction,
        "tool_rpy": pin.rpy.matrixToRpy(line.rotation),
        "range": (line.s_min, line.s_max),
        "core": line.core,
    }

    def listed(values: Any) -> str:
        return f"[{', '.join(f'{value:.10g}' for value in values)}]"

    rows = "\n".join(f"{name} = {listed(values)}" for name, values in entries.items())
    return f"""
# core {found.core_speed:.3f} m/s, whole line {found.whole_speed:.3f} m/s, margin {found.joint_margin:.3f} rad, \
clearance {found.clearance:.3f} m,
# torque at rest {100 * found.torque[0]:.0f} % of a limit, {100 * found.torque[1]:.0f} % with springs
[line]
{rows}
core_speed = {line.core_speed:g}

[arm]
home = {listed(found.home)}"""
