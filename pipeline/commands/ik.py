"""`armdyn ik`: build the SE(3) IK and Jacobian table of a line, and show it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ik import LineTable

commands = typer.Typer(help="The SE(3) IK and Jacobian table of the line.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.add_typer(commands, name="ik")


@commands.command()
def build(
    robot: Annotated[str, typer.Option(help="Name of the robot.")] = "baxter",
    out: Annotated[Path | None, typer.Option(help="Where to write the table; the cache if not given.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="What was built, as JSON; '-' is standard output.")
    ] = None,
) -> None:
    """Build the table of a robot's line."""
    from armdyn.errors import InputError
    from ik.build import build_line_table, default_path
    from urdf import UrdfError, load

    try:
        arm = load(robot)
        table = build_line_table(arm, progress=lambda stage: typer.echo(f"{stage} ...", err=True))
    except UrdfError as error:
        raise InputError(str(error)) from error
    target = out or default_path(arm)
    table.save(target)
    if json_file is not None:
        _write_json({**_as_json(table), "file": str(target)}, json_file)
    if json_file != Path("-"):
        typer.echo(_summary(table))
        typer.echo(f"written to {target}")


@commands.command()
def show(
    file: Annotated[Path, typer.Argument(help="A table that 'armdyn ik build' wrote.")],
    json_file: Annotated[
        Path | None, typer.Option("--json", help="The whole table as JSON; '-' is standard output.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Joint curves, margins and limits as one HTML page.")] = None,
) -> None:
    """Print what a table holds."""
    from armdyn.errors import InputError
    from ik import LineTable
    from urdf import UrdfError, known_robots, load

    table, arm = LineTable.load(file), None
    if table.robot_name in known_robots():
        try:
            arm = load(table.robot_name)
        except UrdfError as error:
            raise InputError(str(error)) from error
        table = LineTable.load(file, arm)
    if report is not None:
        from pipeline.report.ik import ik_report

        ik_report(table, arm, command=f"armdyn ik show {file} --report {report}").write(report)
    if json_file is not None:
        _write_json(_as_json(table), json_file)
    if json_file != Path("-"):
        typer.echo(_summary(table))


def _as_json(table: "LineTable") -> dict[str, Any]:
    """The table in the form of the contract; tool poses are the targets of the tool point."""
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(table.line.rotation).as_quat().tolist()
    return {
        "schema": "armdyn.ik/1",
        "robot": table.robot_name,
        "joints": list(table.joint_names),
        "tool_link": table.tool_frame,
        "tool_offset": table.tool_offset.tolist(),
        "s": table.s.tolist(),
        "q": table.q.tolist(),
        "dq_ds": table.dq_ds.tolist(),
        "tool_position": table.line.position(table.s).tolist(),
        "tool_quaternion": [quaternion] * len(table.s),
        "speed_limit": table.speed_limit.tolist(),
        "joint_margin": table.joint_margin,
    }


def _summary(table: "LineTable") -> str:
    import numpy as np

    line = table.line
    core = table.speed_limit_at(np.linspace(*line.core, 401))
    rows = [
        f"robot        {table.robot_name}: {', '.join(table.joint_names)}",
        f"tool         {table.tool_frame}, point {_numbers(table.tool_offset)} m in it",
        f"line         {_numbers(line.origin)} m + s {_numbers(line.direction)}",
        f"range        s = {line.s_min:g} to {line.s_max:g} m",
        f"nodes        {len(table.s)}, {1e3 * (table.s[1] - table.s[0]):g} mm apart",
        f"joint margin {table.joint_margin:.3f} rad",
        f"core speed   {core.min():.3f} m/s for s = {line.core[0]:g} to {line.core[1]:g} m",
        "",
        "     s [m]  speed limit [m/s]  acceleration limit [m/s^2]",
    ]
    for s in np.linspace(line.s_min, line.s_max, 18):
        rows.append(f"  {s:8.3f}  {table.speed_limit_at(s):17.3f}  {table.acceleration_limit_at(s):26.2f}")
    return "\n".join(rows)


def _numbers(values: Any) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _write_json(content: dict[str, Any], file: Path) -> None:
    from armdyn.errors import InputError

    text = json.dumps(content)
    if file == Path("-"):
        typer.echo(text)
        return
    try:
        file.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); choose another file") from error
