"""A command as a message of each type, and the positions in such a message."""

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.robot.protocol import Vector
from pipeline.ros.topics import CommandKind, RosTopics


def command_message(topics: RosTopics, names: Sequence[str], q: Vector, v: Vector, a: Vector) -> dict[str, Any]:
    """What moves the arm to a posture.

    Args:
        topics: of the arm.
        names: of its joints.
        q: positions (n,) [rad].
        v: velocities (n,) [rad/s].
        a: accelerations (n,) [rad/s^2].
    """
    match topics.kind:
        case CommandKind.JOINT_COMMAND:
            return {"mode": topics.mode.number, "names": list(names), "command": q.tolist()}
        case CommandKind.TRAJECTORY:
            return {"joint_names": list(names), "points": [point_message(q, v, a, topics.horizon)]}
        case CommandKind.ARRAY:
            return {"data": q.tolist()}


def point_message(q: Vector, v: Vector, a: Vector, ahead: float = 0.0) -> dict[str, Any]:
    """A ``trajectory_msgs/JointTrajectoryPoint`` so many seconds ahead."""
    return {
        "positions": q.tolist(),
        "velocities": v.tolist(),
        "accelerations": a.tolist(),
        "time_from_start": {"secs": int(ahead), "nsecs": round(1e9 * (ahead - int(ahead)))},
    }


def positions_in(message: Mapping[str, Any], kind: CommandKind) -> tuple[Any, ...]:
    """The positions that a command asks for, whoever sent it; empty where it asks for none."""
    if kind is CommandKind.TRAJECTORY:
        points = message.get("points") or [{}]
        return tuple(points[-1].get("positions") or ())
    return tuple(message.get("command" if kind is CommandKind.JOINT_COMMAND else "data") or ())
