"""Report of an IK table (joint positions along a tool path): whether and how fast the path can be followed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from armdyn.document import MAX_CARD_ROWS, Chart, Column, Document, KeyFigure, ResultLevel, Section, Table
from ik import JointMotion, PathTable
from pipeline.report.theme import LIMIT_STYLE, MODEL_STYLE, REFERENCE_STYLE
from urdf import Line, Robot

TIGHT_JOINT_LIMIT_MARGIN = 0.1
"""Distance to a joint limit below which the report of an IK table warns [rad]."""


def ik_document(table: PathTable) -> Document:
    """Document of an IK table: whether and how fast the path can be followed, and what limits it at a few nodes."""
    low, high = table.path.core
    core = float(table.speed_limit_at(np.linspace(low, high, 1001)).min())
    overloaded, helped = table.torque_share.max(axis=0)
    what = "creeping, against its dry friction," if np.any(table.torque.forward) else "holding still"
    kind = path = table.path.describe()["kind"]
    if isinstance(table.path, Line):
        path = f"{_vector(table.path.origin)} m + s {_vector(table.path.direction)}"
    extent = f"s = {table.s[0]:g} to {table.s[-1]:g} m"
    return Document(
        title=f"IK table of {table.robot_name}",
        level=ResultLevel.CAUTION
        if table.joint_margin < TIGHT_JOINT_LIMIT_MARGIN or overloaded > 1.0
        else ResultLevel.GOOD,
        verdict=f"{table.s[-1] - table.s[0]:.2f} m of {kind}, {core:.2f} m/s in its core, "
        f"every joint at least {table.joint_margin:.2f} rad from its limits, "
        f"{what} takes up to {100 * overloaded:.0f} % of a torque limit.",
        subtitle=f"{len(table.s)} nodes, {1e3 * (table.s[1] - table.s[0]):g} mm apart, from {extent}",
        key_figures=[
            KeyFigure("robot", table.robot_name, ", ".join(table.joint_names)),
            KeyFigure("tool", table.tool_frame, f"point {_vector(table.tool_offset)} m in it"),
            KeyFigure("path", path, extent),
            KeyFigure("core speed", f"{core:.3f} m/s", f"s = {low:g} to {high:g} m"),
            KeyFigure("joint margin", f"{table.joint_margin:.3f} rad"),
            KeyFigure("acceleration", f"{table.acceleration_limit.min():.1f} m/s^2", "joints, at full speed, least"),
            KeyFigure("torque at rest", f"{100 * overloaded:.0f} %", f"{100 * helped:.0f} % with springs"),
        ],
        sections=[Section("Along the path", tables=[_node_table(table)])],
    )


def ik_report(table: PathTable, robot: Robot | None) -> Document:
    """Report of an IK table: its document, with figures of speed, acceleration, joints and manipulability.

    Args:
        table: the IK table.
        robot: robot of the table, whose description's defects become notes; None for no such notes.
    """
    document = ik_document(table)
    figure = _along_path(table, "sqrt det(J Jᵀ)")
    for values, name, style in zip(
        table.manipulability.T, ("linear [m³/rad³]", "angular [1]"), (MODEL_STYLE, REFERENCE_STYLE), strict=True
    ):
        figure.add_scatter(x=table.s, y=values, name=name, **style)
    dexterity = Section("Manipulability", charts=[Chart(figure, "Yoshikawa 1985; zero at a singularity.")])
    sections = [_speed_section(table), *_joint_sections(table), dexterity, *document.sections]
    return replace(document, sections=sections, notes=() if robot is None else robot.defects)


def look_document(table: PathTable, s: np.ndarray, motion: JointMotion) -> Document:
    """Document of the joints' motion at the places s of a table's path, (k,) [m], with the tool's limits there."""
    place = Column("s [m]", s.tolist(), ".4f")

    def of_joints(values: np.ndarray, what: str) -> Table:
        columns = [Column(name, values[:, j].tolist(), ".5f") for j, name in enumerate(table.joint_names)]
        return Table([place, *columns], caption=what)

    limits = [
        place,
        Column("largest speed [m/s]", table.speed_limit_at(s).tolist(), ".3f"),
        Column("largest acceleration [m/s^2]", table.acceleration_limit_at(s).tolist(), ".2f"),
    ]
    tables = [of_joints(motion.q, "positions, rad or m"), Table(limits, caption="limits of the tool along the path")]
    tables += [of_joints(motion.v, "velocities, rad/s or m/s")] if motion.v.any() else []
    kind = table.path.describe()["kind"]
    return Document(
        f"IK table of {table.robot_name}",
        f"{len(s)} place{'s' if len(s) != 1 else ''} on a {kind} of {table.tool_frame}.",
        [Section("Along the path", tables=tables)],
    )


def _node_table(table: PathTable) -> Table:
    s = np.linspace(table.s[0], table.s[-1], MAX_CARD_ROWS)
    nodes = [int(np.abs(table.s - at).argmin()) for at in s]
    low, high = np.array([table.torque_acceleration_range(at) for at in s]).T
    return Table(
        [
            Column("s [m]", s.tolist(), ".3f"),
            Column("speed [m/s]", [float(table.speed_limit_at(at)) for at in s], ".3f"),
            Column("acceleration [m/s^2]", [float(table.acceleration_limit_at(at)) for at in s], ".2f"),
            Column("by torque [m/s^2]", np.minimum(-low, high).tolist(), ".2f"),
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


def _speed_section(table: PathTable) -> Section:
    slowest = np.abs(table.dq_ds / table.limits.velocity).argmax(axis=1)
    speed = _along_path(table, "speed limit [m/s]")
    speed.add_scatter(x=table.s, y=table.speed_limit, name="speed", **MODEL_STYLE)
    by_joints = [table.acceleration_limit_at(table.s, 0.0 * table.s), table.acceleration_limit]
    acceleration = _along_path(
        table, "acceleration [m/s^2]", ("joints, at rest", "joints, at full speed"), np.transpose(by_joints)
    )
    for springs in (False, True) if table.torque.springs.any() else (False,):
        name = "torque, at rest, with springs" if springs else "torque, at rest"
        low, high = table.torque_acceleration_range(table.s, 0.0, springs)
        acceleration.add_scatter(
            x=table.s, y=np.minimum(-low, high), name=name, **(REFERENCE_STYLE if springs else LIMIT_STYLE)
        )
    caption = (
        "What the joints' acceleration limits allow, and what their torques allow in the weaker direction; "
        "negative where the torque does not even suffice to creep."
    )
    return Section(
        "Speed and acceleration",
        f"Of the path, the speed is limited by {_shares(slowest, table.joint_names)}.",
        [Chart(speed), Chart(acceleration, caption)],
    )


def _joint_sections(table: PathTable) -> list[Section]:
    names, q = table.joint_names, table.q
    middle, half = (table.limits.lower + table.limits.upper) / 2, (table.limits.upper - table.limits.lower) / 2
    fastest = np.abs(table.dq_ds).max(axis=0)
    extremes = Table([
        Column("joint", names),
        Column("lowest [rad]", q.min(axis=0).tolist(), ".3f"),
        Column("highest [rad]", q.max(axis=0).tolist(), ".3f"),
        Column("margin [rad]", table.margin.min(axis=0).tolist(), ".3f"),
        Column("largest |dq/ds| [rad/m]", fastest.tolist(), ".2f"),
    ])  # fmt: skip
    share = _along_path(table, "share of the range [-1, 1]", names, (q - middle) / half, (-1.0, 1.0))
    margin = _along_path(table, "distance to the limit [rad]", names, table.margin, (0.0,))
    torque = _along_path(table, "share of the torque limit", names, table.torque.gravity / table.limits.effort)
    helped = np.flatnonzero(table.torque.springs.any(axis=0))
    with_springs = (table.torque.gravity + table.torque.springs) / table.limits.effort
    for joint in helped:
        torque.add_scatter(
            x=table.s, y=with_springs[:, joint], name=f"{names[joint]} with its springs", **REFERENCE_STYLE
        )
    _add_bounds(torque, table, (-1.0, 1.0))
    held = "Gravity alone, as a share of each joint's limit."
    if len(helped):
        joints = ", ".join(names[joint] for joint in helped)
        held = f"Gravity as a share of each joint's limit; the real robot has springs on {joints}, shown dashed."
    return [
        Section(
            "Joint positions",
            charts=[
                Chart(_along_path(table, "joint position [rad]", names, q)),
                Chart(share, "One smooth branch; the dashed lines are the position limits."),
            ],
            tables=[extremes],
        ),
        Section(
            "Joint margins", f"Closest to its limit is {_shares(table.margin.argmin(axis=1), names)}.", [Chart(margin)]
        ),
        Section("Torque at rest", held, [Chart(torque)]),
    ]


def _along_path(
    table: PathTable,
    title: str,
    names: Sequence[str] = (),
    values: np.ndarray | None = None,
    bounds: Sequence[float] = (),
) -> go.Figure:
    """A figure along the path, with a line for every column of `values`, (n, k), and dashed bounds."""
    figure = go.Figure(layout={"xaxis_title": "path coordinate s [m]", "yaxis_title": title})
    for name, column in zip(names, () if values is None else values.T, strict=True):
        figure.add_scatter(x=table.s, y=column, name=name, mode="lines")
    _add_bounds(figure, table, bounds)
    return figure


def _add_bounds(figure: go.Figure, table: PathTable, bounds: Sequence[float]) -> None:
    for bound in bounds:
        figure.add_scatter(x=table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT_STYLE)
