"""Document of an IK table: is the path usable, how fast, and what limits it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from armdyn.document import MOST_ROWS, Chart, Column, Document, KeyFigure, Level, Section, Table
from ik import PathTable
from pipeline.report.theme import LIMIT, MODEL, REFERENCE
from urdf import Line, Robot

PATH_AXIS = "path coordinate s [m]"
TIGHT = 0.1  # rad to a joint limit below which a table is called tight


def ik_document(table: PathTable) -> Document:
    """Whether the path is usable, how fast, and what limits it, at a few of its nodes."""
    low, high = table.path.core
    core = float(table.speed_limit_at(np.linspace(low, high, 1001)).min())
    overloaded, helped = table.torque_share.max(axis=0)
    tight = table.joint_margin < TIGHT or overloaded > 1.0
    path = table.path.describe()["kind"]
    if isinstance(table.path, Line):
        path = f"{_vector(table.path.origin)} m + s {_vector(table.path.direction)}"
    return Document(
        title=f"IK table of {table.robot_name}",
        level=Level.CAUTION if tight else Level.GOOD,
        verdict=f"{table.s[-1] - table.s[0]:.2f} m of {table.path.describe()['kind']}, {core:.2f} m/s in its core, "
        f"every joint at least {table.joint_margin:.2f} rad from its limits, "
        f"holding still takes up to {100 * overloaded:.0f} % of a torque limit.",
        subtitle=f"{len(table.s)} nodes, {1e3 * (table.s[1] - table.s[0]):g} mm apart, from s = {table.s[0]:g} to "
        f"{table.s[-1]:g} m",
        key_figures=[
            KeyFigure("robot", table.robot_name, ", ".join(table.joint_names)),
            KeyFigure("tool", table.tool_frame, f"point {_vector(table.tool_offset)} m in it"),
            KeyFigure("path", path, f"s = {table.s[0]:g} to {table.s[-1]:g} m"),
            KeyFigure("core speed", f"{core:.3f} m/s", f"s = {low:g} to {high:g} m"),
            KeyFigure("joint margin", f"{table.joint_margin:.3f} rad"),
            KeyFigure("acceleration", f"{table.acceleration_limit.min():.1f} m/s²", "joints, at full speed, least"),
            KeyFigure("torque at rest", f"{100 * overloaded:.0f} %", f"{100 * helped:.0f} % with springs"),
        ],
        sections=[Section("Along the path", tables=[_node_table(table)])],
    )


def ik_report(table: PathTable, robot: Robot | None) -> Document:
    """The same with figures.

    Args:
        table: what was built.
        robot: whose table it is, for the defects of its description; None leaves them out.
    """
    kinds = (speed_section, joint_section, margin_section, torque_section, dexterity_section)
    document = ik_document(table)
    sections = [*(section(table) for section in kinds), *document.sections]
    return replace(document, sections=sections, notes=() if robot is None else robot.defects)


def _node_table(table: PathTable, most: int = MOST_ROWS) -> Table:
    """Speed, acceleration, margin, torque and manipulability at nodes that are evenly apart."""
    s = np.linspace(table.s[0], table.s[-1], most)
    nodes = [int(np.abs(table.s - at).argmin()) for at in s]
    low, high = np.array([table.torque_acceleration_range(at) for at in s]).T
    return Table(
        [
            Column("s [m]", s.tolist(), ".3f"),
            Column("speed [m/s]", [float(table.speed_limit_at(at)) for at in s], ".3f"),
            Column("acceleration [m/s²]", [float(table.acceleration_limit_at(at)) for at in s], ".2f"),
            Column("by torque [m/s²]", np.minimum(-low, high).tolist(), ".2f"),
            Column("margin [rad]", table.margin[nodes].min(axis=1).tolist(), ".3f"),
            Column("torque", table.torque_share[nodes, 0].tolist(), ".0%"),
            Column("manipulability", table.manipulability[nodes, 0].tolist(), ".3f"),
        ]
    )


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _shares(joints: np.ndarray, names: Sequence[str]) -> str:
    counted = sorted(((np.mean(joints == joint), name) for joint, name in enumerate(names)), reverse=True)
    return ", ".join(f"{name} on {100 * share:.0f} %" for share, name in counted if share)


def speed_section(table: PathTable) -> Section:
    """How fast the tool may move, and which joint limits the speed where."""
    slowest = np.abs(table.dq_ds / table.limits.velocity).argmax(axis=1)
    speed = _along_path("speed limit [m/s]")
    speed.add_scatter(x=table.s, y=table.speed_limit, name="speed", **MODEL)
    acceleration = _along_path("acceleration [m/s²]")
    for name, values in (("at rest", table.acceleration_limit_at(table.s, 0.0 * table.s)), ("at full speed", None)):
        limit = table.acceleration_limit if values is None else values
        acceleration.add_scatter(x=table.s, y=limit, name=f"joints, {name}", mode="lines")
    for springs in (False, True) if table.torque.springs.any() else (False,):
        name = "torque, at rest, with springs" if springs else "torque, at rest"
        low, high = table.torque_acceleration_range(table.s, 0.0, springs)
        acceleration.add_scatter(x=table.s, y=np.minimum(-low, high), name=name, **(REFERENCE if springs else LIMIT))
    caption = (
        "What the joints' acceleration limits allow, and what their torques allow in the weaker direction; "
        "negative where the torque does not even hold the arm."
    )
    return Section(
        "Speed and acceleration",
        f"Of the path, the speed is limited by {_shares(slowest, table.joint_names)}.",
        [Chart(speed), Chart(acceleration, caption)],
    )


def joint_section(table: PathTable) -> Section:
    """Where the joints are, as they are and as shares of their range, and their extremes."""
    plain, figure = _along_path("joint position [rad]"), _along_path("share of the range [-1, 1]")
    middle, half = (table.limits.lower + table.limits.upper) / 2, (table.limits.upper - table.limits.lower) / 2
    margin, rows = table.margin.min(axis=0), []
    for joint, name in enumerate(table.joint_names):
        q = table.q[:, joint]
        plain.add_scatter(x=table.s, y=q, name=name, mode="lines")
        figure.add_scatter(x=table.s, y=(q - middle[joint]) / half[joint], name=name, mode="lines")
        fastest = np.abs(table.dq_ds[:, joint]).max()
        rows.append([name, f"{q.min():.3f}", f"{q.max():.3f}", f"{margin[joint]:.3f}", f"{fastest:.2f}"])
    _add_bounds(figure, table, -1.0, 1.0)
    return Section(
        "Joint positions",
        charts=[Chart(plain), Chart(figure, "One smooth branch; the dashed lines are the position limits.")],
        tables=[Table.of(["joint", "lowest [rad]", "highest [rad]", "margin [rad]", "largest |dq/ds| [rad/m]"], rows)],
    )


def margin_section(table: PathTable) -> Section:
    """How far the joints are from the nearer of their limits, and which joint is closest where."""
    figure = _along_path("distance to the limit [rad]")
    for joint, name in enumerate(table.joint_names):
        figure.add_scatter(x=table.s, y=table.margin[:, joint], name=name, mode="lines")
    _add_bounds(figure, table, 0.0)
    closest = _shares(table.margin.argmin(axis=1), table.joint_names)
    return Section("Joint margins", f"Closest to its limit is {closest}.", [Chart(figure)])


def torque_section(table: PathTable) -> Section:
    """What it takes to hold the arm along the path, and what the springs change."""
    figure = _along_path("share of the torque limit")
    for joint, name in enumerate(table.joint_names):
        share = table.torque.gravity[:, joint] / table.limits.effort[joint]
        figure.add_scatter(x=table.s, y=share, name=name, mode="lines")
    helped = [int(joint) for joint in np.flatnonzero(table.torque.springs.any(axis=0))]
    for joint in helped:
        share = (table.torque.gravity + table.torque.springs)[:, joint] / table.limits.effort[joint]
        figure.add_scatter(x=table.s, y=share, name=f"{table.joint_names[joint]} with its springs", **REFERENCE)
    _add_bounds(figure, table, -1.0, 1.0)
    sentence = "Gravity alone, as a share of each joint's limit."
    if helped:
        joints = ", ".join(table.joint_names[joint] for joint in helped)
        sentence = f"Gravity as a share of each joint's limit; the real robot has springs on {joints}, shown dashed."
    return Section("Torque at rest", sentence, [Chart(figure)])


def dexterity_section(table: PathTable) -> Section:
    """How far the arm is from a singularity: Yoshikawa's measure for shifting and for turning the tool."""
    figure = _along_path("sqrt det(J Jᵀ)")
    for column, name, style in ((0, "linear [m³/rad³]", MODEL), (1, "angular [1]", REFERENCE)):
        figure.add_scatter(x=table.s, y=table.manipulability[:, column], name=name, **style)
    return Section("Manipulability", charts=[Chart(figure, "Yoshikawa 1985; zero at a singularity.")])


def _along_path(title: str) -> go.Figure:
    return go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": title})


def _add_bounds(figure: go.Figure, table: PathTable, *bounds: float) -> None:
    for bound in bounds:
        figure.add_scatter(x=table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT)
