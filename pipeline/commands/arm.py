"""`armdyn arm`: the dynamics of an arm in closed form."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.console.options import (
    JointsOption,
    JsonOption,
    MeshesOption,
    RobotOption,
    ToolOption,
    UrdfOption,
    numbers,
    which_robot,
)
from pipeline.console.screen import write_answer

if TYPE_CHECKING:
    from armdyn.arm.posture import ArmPosture, Ellipsoid
    from urdf import Robot

PANEL = "Motions of an arm"


group = typer.Typer(help="The dynamics of an arm in closed form.", no_args_is_help=True)


@group.callback()
def about() -> None:
    """The dynamics of an arm in closed form."""


@group.command()
def show(
    robot: RobotOption = "baxter",
    urdf_file: UrdfOption = None,
    joints: JointsOption = None,
    tool: ToolOption = None,
    meshes: MeshesOption = True,
    at: Annotated[
        str | None, typer.Option(help="Joint positions [rad or m], separated by commas; home if not given.")
    ] = None,
    velocity: Annotated[
        str | None, typer.Option(help="Joint velocities [rad/s or m/s], separated by commas; rest if not given.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Gravity, inertia, Coriolis, energy, regressor and what the tool can reach in speed and force, at a posture."""
    from armdyn.arm.posture import arm_posture

    arm = which_robot(robot, urdf_file, joints, tool, meshes)
    posture = arm_posture(
        arm,
        None if at is None else numbers(at, "--at"),
        None if velocity is None else numbers(velocity, "--velocity"),
    )
    if write_answer(json_file, lambda: _as_json(arm, posture)):
        typer.echo(_summary(arm, posture))


def _units(robot: "Robot") -> list[tuple[str, str]]:
    """Units of position and torque per joint."""
    slides = ["P" in robot.model.joints[joint].shortname() for joint in range(1, robot.model.njoints)]
    return [("m", "N") if sliding else ("rad", "N m") for sliding in slides]


def _summary(robot: "Robot", posture: "ArmPosture") -> str:
    rows = [
        f"robot      {robot.name}, tool {robot.tool_frame}",
        f"tool at    {_row(posture.tool_position, 4)} m",
        f"energy     {posture.kinetic_energy:.4g} J kinetic, {posture.potential_energy:.4g} J potential",
        f"manipulability {posture.manipulability:.3g} (shifting the tool)",
        "",
        f"{'joint':>22} {'position':>13} {'margin':>8} {'velocity':>9} {'gravity':>13} {'springs':>8} {'limit':>8}",
    ]
    for j, (name, (angle, torque)) in enumerate(zip(robot.joint_names, _units(robot), strict=True)):
        rows.append(
            f"{name:>22} {posture.q[j]:8.4f} {angle:<4} {posture.margin[j]:8.3f} {posture.v[j]:9.3f} "
            f"{posture.gravity[j]:9.3f} {torque:<3} {posture.springs[j]:8.2f} {robot.limits.effort[j]:8.1f}"
        )
    rows += ["", "inertia M [kg m^2; kg m, kg for sliding joints]", *_matrix(posture.inertia)]
    if posture.v.any():
        rows += ["", "Coriolis C [N m s]", *_matrix(posture.coriolis)]
    rows += ["", *_ellipsoid("speed of the tool", "m/s", posture.speed)]
    rows += ["", *_ellipsoid("force at the tool, at rest", "N", posture.force)]
    rows += ["", f"regressor  {posture.regressor.shape[0]} x {posture.regressor.shape[1]}, in the JSON"]
    if robot.defects:
        rows += ["", "defects of the description", *(f"  {defect}" for defect in robot.defects)]
    return "\n".join(rows)


def _ellipsoid(title: str, unit: str, ellipsoid: "Ellipsoid") -> list[str]:
    rows = [f"{title} [{unit}]: semi-axes of the ellipsoid, and largest straight along x, y, z joint by joint"]
    for length, axis in zip(ellipsoid.lengths, ellipsoid.axes.T, strict=True):
        rows.append(f"  {length:10.3f} along {_row(axis, 3)}")
    return [*rows, f"  x {ellipsoid.along[0]:.3f}, y {ellipsoid.along[1]:.3f}, z {ellipsoid.along[2]:.3f}"]


def _row(values: Iterable[float], digits: int) -> str:
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"


def _matrix(values: Iterable[Iterable[float]]) -> list[str]:
    return ["  " + " ".join(f"{value:9.4f}" for value in row) for row in values]


LISTED = ("q", "v", "margin", "gravity", "springs", "inertia", "coriolis", "damping")
"""Of a posture, what stands in the JSON under its own name."""


def _as_json(robot: "Robot", posture: "ArmPosture") -> dict[str, Any]:
    from armdyn.arm.posture import PER_LINK

    return {
        "schema": "armdyn.arm/1",
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "units": {
            "position": [angle for angle, _ in _units(robot)],
            "torque": [torque for _, torque in _units(robot)],
            "energy": "J",
            "speed": "m/s",
            "force": "N",
        },
        "tool_link": robot.tool_frame,
        "tool_offset": robot.tool_offset.tolist(),
        "tool_position": posture.tool_position.tolist(),
        "tool_rotation": posture.tool_rotation.tolist(),
        **{name: getattr(posture, name).tolist() for name in LISTED},
        "kinetic_energy": posture.kinetic_energy,
        "potential_energy": posture.potential_energy,
        "regressor": posture.regressor.tolist(),
        "parameter_names": [f"{joint}.{name}" for joint in robot.joint_names for name in PER_LINK],
        "parameters": posture.parameters.tolist(),
        "jacobian": posture.jacobian.tolist(),
        "manipulability": posture.manipulability,
        "speed_ellipsoid": _ellipsoid_json(posture.speed),
        "force_ellipsoid": _ellipsoid_json(posture.force),
        "defects": list(robot.defects),
    }


def _ellipsoid_json(ellipsoid: "Ellipsoid") -> dict[str, Any]:
    """Infinite values, which JSON has not, become null."""

    def finite(values: Iterable[float]) -> list[float | None]:
        return [float(value) if value < float("inf") else None for value in values]

    return {
        "axes": ellipsoid.axes.T.tolist(),
        "lengths": finite(ellipsoid.lengths),
        "along_xyz": finite(ellipsoid.along),
    }
