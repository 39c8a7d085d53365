"""What `armdyn ik` prints of a table and of a line that was found."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ik import PathTable
    from ik.search import Found


def table_json(table: "PathTable") -> dict[str, Any]:
    """The table in the form of the contract; tool poses are the targets of the tool point."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    rotation, position = table.path.pose(table.s)
    low, high = table.torque_acceleration_range(table.s)
    return {
        "schema": "armdyn.ik/1",
        "robot": table.robot_name,
        "joints": list(table.joint_names),
        "tool_link": table.tool_frame,
        "tool_offset": table.tool_offset.tolist(),
        "s": table.s.tolist(),
        "q": table.q.tolist(),
        "dq_ds": table.dq_ds.tolist(),
        "tool_position": position.T.tolist(),
        "tool_quaternion": Rotation.from_matrix(np.array(rotation.transpose(2, 0, 1))).as_quat().tolist(),
        "speed_limit": table.speed_limit.tolist(),
        "joint_margin": table.joint_margin,
        "path": table.path.describe(),
        "acceleration_limit": table.acceleration_limit.tolist(),
        "torque_acceleration_range": np.stack((low, high), axis=1).tolist(),
        "torque_share": table.torque_share.tolist(),
        "margin": table.margin.min(axis=1).tolist(),
        "manipulability": table.manipulability.tolist(),
    }


def summary(table: "PathTable") -> str:
    """What a person wants to know of a table."""
    import numpy as np

    from ik import LinePath
    from pipeline.report.ik import core_of

    low, high = core_of(table)
    core = table.speed_limit_at(np.linspace(low, high, 401))
    rows = [
        f"robot        {table.robot_name}: {', '.join(table.joint_names)}",
        f"tool         {table.tool_frame}, point {_numbers(table.tool_offset)} m in it",
        f"path         {table.path.describe()['kind']}",
    ]
    if isinstance(table.path, LinePath):
        line = table.path.line
        rows[-1] = f"line         {_numbers(line.origin)} m + s {_numbers(line.direction)}"
    rows += [
        f"range        s = {table.s[0]:g} to {table.s[-1]:g} m",
        f"nodes        {len(table.s)}, {1e3 * (table.s[1] - table.s[0]):g} mm apart",
        f"joint margin {table.joint_margin:.3f} rad",
        f"core speed   {core.min():.3f} m/s for s = {low:g} to {high:g} m",
        f"torque       {100 * table.torque_share[:, 0].max():.0f} % of a limit at rest, "
        f"{100 * table.torque_share[:, 1].max():.0f} % with springs",
        "",
        "     s [m]  speed [m/s]  acceleration [m/s^2]  by torque [m/s^2]  margin [rad]  torque [%]  manipulability",
    ]
    for s in np.linspace(table.s[0], table.s[-1], 18):
        node = int(np.abs(table.s - s).argmin())
        lowest, highest = table.torque_acceleration_range(s)
        rows.append(
            f"  {s:8.3f}  {table.speed_limit_at(s):11.3f}  {table.acceleration_limit_at(s):20.2f}  "
            f"{min(-lowest, highest):17.2f}  {table.margin[node].min():12.3f}  "
            f"{100 * table.torque_share[node, 0]:10.0f}  {table.manipulability[node, 0]:14.3f}"
        )
    return "\n".join(rows)


def as_settings(found: "Found") -> str:
    """What was found, as entries of a robot's settings file."""
    import pinocchio as pin

    line = found.line

    def row(values: Any) -> str:
        return "[" + ", ".join(f"{value:.10g}" for value in values) + "]"

    return "\n".join(
        [
            "",
            f"# core {found.core_speed:.3f} m/s, whole line {found.whole_speed:.3f} m/s, "
            f"margin {found.joint_margin:.3f} rad, clearance {found.clearance:.3f} m,",
            f"# torque at rest {100 * found.torque[0]:.0f} % of a limit, {100 * found.torque[1]:.0f} % with springs",
            "[line]",
            f"origin = {row(line.origin)}",
            f"direction = {row(line.direction)}",
            f"tool_rpy = {[float(angle) for angle in pin.rpy.matrixToRpy(line.rotation)]}",
            f"range = {row((line.s_min, line.s_max))}",
            f"core = {row(line.core)}",
            f"core_speed = {line.core_speed:g}",
            "",
            "[arm]",
            f"home = {row(found.home)}",
        ]
    )


def found_json(found: "Found") -> dict[str, Any]:
    """A line that was found, and what it is worth."""
    return {
        "line": {
            "origin": found.line.origin.tolist(),
            "direction": found.line.direction.tolist(),
            "rotation": found.line.rotation.tolist(),
            "range": [found.line.s_min, found.line.s_max],
            "core": list(found.line.core),
            "core_speed": found.line.core_speed,
        },
        "home": found.home.tolist(),
        "core_speed": found.core_speed,
        "whole_speed": found.whole_speed,
        "joint_margin": found.joint_margin,
        "clearance": found.clearance,
        "torque": list(found.torque),
    }


def _numbers(values: Any) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
