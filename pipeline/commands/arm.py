"""The command `armdyn arm`: show the terms of an arm's equations of motion."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.document import Column, Document, KeyFigure, Section, Table
from pipeline.console.options import ArmChoice, JsonOption, parse_numbers
from pipeline.console.screen import finish_command

if TYPE_CHECKING:
    from armdyn.arm.posture import ArmPosture, ManipulabilityEllipsoid
    from armdyn.recording.channels import FloatArray
    from urdf import Robot

HELP_PANEL = "Motions of an arm"


group = typer.Typer(help="Show the terms of an arm's equations of motion.", no_args_is_help=True)


@group.callback()
def about() -> None:
    """Show the terms of an arm's equations of motion."""


@group.command()
def show(
    choice: ArmChoice,
    at: Annotated[
        str | None, typer.Option(help="Joint positions [rad or m], separated by commas; by default the home posture.")
    ] = None,
    velocity: Annotated[
        str | None, typer.Option(help="Joint velocities [rad/s or m/s], separated by commas; by default zero.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Show gravity, inertia, Coriolis terms, energy, regressor and the tool's possible speed and force at a posture."""
    from armdyn.arm.posture import arm_posture

    arm = choice.load()
    posture = arm_posture(
        arm,
        None if at is None else parse_numbers(at, "--at"),
        None if velocity is None else parse_numbers(velocity, "--velocity"),
    )
    finish_command(_document(arm, posture), lambda: _as_json(arm, posture), json_file)


def _units(robot: "Robot") -> list[tuple[str, str]]:
    slides = ["P" in robot.model.joints[joint].shortname() for joint in range(1, robot.model.njoints)]
    return [("m", "N") if sliding else ("rad", "N m") for sliding in slides]


def _document(robot: "Robot", posture: "ArmPosture") -> Document:
    positions, torques = zip(*_units(robot), strict=True)
    joints = Table(
        [
            Column("joint", robot.joint_names),
            Column("position", posture.q.tolist(), ".4f"),
            Column("", positions),
            Column("margin", posture.margin.tolist(), ".3f"),
            Column("velocity", posture.v.tolist(), ".3f"),
            Column("gravity", posture.gravity.tolist(), ".3f"),
            Column("springs", posture.springs.tolist(), ".2f"),
            Column("limit", robot.model.effortLimit.tolist(), ".1f"),
            Column("", torques),
        ]
    )
    sections = [
        Section("Joints", tables=[joints]),
        Section("Inertia M [kg m^2; kg m, kg for sliding joints]", tables=[_matrix(robot, posture.inertia)]),
    ]
    if posture.v.any():
        sections.append(Section("Coriolis C [N m s]", tables=[_matrix(robot, posture.coriolis)]))
    sections += _ellipsoid("speed of the tool [m/s]", posture.speed)
    sections += _ellipsoid("force at the tool, at rest [N]", posture.force)
    x, y, z = posture.tool_position
    return Document(
        f"Posture of {robot.name}",
        f"{robot.name}, tool {robot.tool_frame} at ({x:.4f}, {y:.4f}, {z:.4f}) m",
        sections,
        key_figures=[
            KeyFigure("kinetic energy", f"{posture.kinetic_energy:.4g} J"),
            KeyFigure("potential energy", f"{posture.potential_energy:.4g} J"),
            KeyFigure("manipulability", f"{posture.manipulability:.3g}", "shifting the tool"),
            KeyFigure("regressor", " x ".join(map(str, posture.regressor.shape)), "in the JSON"),
        ],
        notes=robot.defects,
    )


def _matrix(robot: "Robot", values: "FloatArray") -> Table:
    columns = [
        Column(name, column.tolist(), ".4f", title=name)
        for name, column in zip(robot.joint_names, values.T, strict=True)
    ]
    return Table([Column("", robot.joint_names), *columns])


def _ellipsoid(title: str, ellipsoid: "ManipulabilityEllipsoid | None") -> list[Section]:
    if ellipsoid is None:
        return []
    x, y, z = ellipsoid.along
    axes = [Column(name, row.tolist(), ".3f") for name, row in zip("xyz", ellipsoid.axes, strict=True)]
    sentence = f"Straight along x {x:.3f}, y {y:.3f}, z {z:.3f}, joint by joint; the semi-axes of the ellipsoid:"
    table = Table([Column("length", ellipsoid.lengths.tolist(), ".3f"), *axes])
    return [Section(title, sentence, tables=[table])]


def _as_json(robot: "Robot", posture: "ArmPosture") -> dict[str, Any]:
    """JSON output ``armdyn.arm/1``; infinite values become null."""
    from armdyn.arm.posture import LINK_PARAMETER_NAMES
    from pipeline.fields import attributes_as_json

    positions, torques = zip(*_units(robot), strict=True)
    posed = "q v margin gravity springs inertia coriolis damping kinetic_energy potential_energy regressor"
    return {
        "schema": "armdyn.arm/1",
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "units": {
            "position": list(positions), "torque": list(torques), "energy": "J", "speed": "m/s", "force": "N",
        },
        "tool_link": robot.tool_frame,
        "tool_offset": robot.tool_offset.tolist(),
        **attributes_as_json(posture, f"tool_position tool_rotation {posed}"),
        "parameter_names": [f"{joint}.{name}" for joint in robot.joint_names for name in LINK_PARAMETER_NAMES],
        **attributes_as_json(posture, "parameters jacobian manipulability"),
        **{
            f"{name}_ellipsoid": ellipsoid
            and attributes_as_json(ellipsoid, "axes= lengths along_xyz=along", axes=ellipsoid.axes.T)
            for name, ellipsoid in (("speed", posture.speed), ("force", posture.force))
        },
        "defects": list(robot.defects),
    }  # fmt: skip
