"""ROS topics of an arm, from the table ``[ros]`` of its settings file, and messages that command it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

from armdyn.errors import InputError, error_location
from armdyn.toml_file import read_toml
from pipeline.robot.protocol import Vector
from urdf.loader import SETTINGS_DIRECTORY, known_robots
from urdf.toml_tables import TomlValueCheck, table_to_dataclass


class CommandKind(Enum):
    """ROS type of the messages that command the arm."""

    JOINT_COMMAND = "baxter_core_msgs/JointCommand"
    TRAJECTORY = "trajectory_msgs/JointTrajectory"
    ARRAY = "std_msgs/Float64MultiArray"


JOINT_COMMAND_MODES = {"position": 1, "raw_position": 4}
"""Modes of Baxter's message ``JointCommand``: the number in the message, by the word in a settings file."""


_Name = Annotated[
    str,
    TomlValueCheck(
        lambda name: name[:1] == "/" and name[-1] != "/", "give a name that begins with '/' and ends otherwise"
    ),
]
_Seconds = Annotated[float, TomlValueCheck(lambda seconds: 0.02 <= seconds <= 1.0, "give a time from 0.02 to 1 s")]


@dataclass(frozen=True)
class RosTopics:
    """Names and types of an arm's topics on ROS.

    Attributes:
        joint_states: topic of type ``sensor_msgs/JointState``.
        command: topic of commands that move the arm.
        type: type of these commands.
        mode: mode of a ``JointCommand``, see `JOINT_COMMAND_MODES`.
        feed_forward: topic of type ``trajectory_msgs/JointTrajectoryPoint`` for every command's velocities and
            accelerations; None for no such topic.
        timeout: topic that sets the longest time without a command, ``std_msgs/Float64``; None for no such topic.
        command_timeout: longest time without a command [s], after which the robot holds its posture.
        speed_ratio: topic that sets the share of the speed limits, ``std_msgs/Float64``; None for no such topic.
        enabling: name space of Baxter's ``state``, ``set_super_enable`` and ``set_super_reset``; None without them.
        horizon: time from a ``JointTrajectory`` to its only point [s].
    """

    joint_states: _Name
    command: _Name
    type: CommandKind = CommandKind.JOINT_COMMAND
    mode: Annotated[
        str, TomlValueCheck(JOINT_COMMAND_MODES.__contains__, f"choose one of {', '.join(JOINT_COMMAND_MODES)}")
    ] = "raw_position"
    feed_forward: _Name | None = None
    timeout: _Name | None = None
    command_timeout: _Seconds = 0.1
    speed_ratio: _Name | None = None
    enabling: _Name | None = None
    horizon: _Seconds = 0.02


def settings_file(robot: str) -> Path:
    """Path of a robot's settings file, from the name of a known robot or from a file name."""
    return SETTINGS_DIRECTORY / f"{robot}.toml" if robot in known_robots() else Path(robot)


def read_topics(file: Path) -> RosTopics:
    """Read the ROS topics from the table ``[ros]`` of a robot's settings file.

    Raises:
        InputError: the table is missing, or an entry has the wrong form.
    """
    table = read_toml(file, "; give a robot's settings file").get("ros")
    if not isinstance(table, dict):
        raise InputError(f"{file}: there is no table [ros]; see urdf/robots/baxter.toml for an example")
    with error_location(file):
        return table_to_dataclass(RosTopics, table, "[ros]")


def command_message(topics: RosTopics, names: Sequence[str], q: Vector, v: Vector, a: Vector) -> dict[str, Any]:
    """Message that commands the arm.

    Args:
        topics: topics of the arm, with the type of the message.
        names: names of the joints.
        q: positions (n,) [rad].
        v: velocities (n,) [rad/s].
        a: accelerations (n,) [rad/s^2].
    """
    match topics.type:
        case CommandKind.JOINT_COMMAND:
            return {"mode": JOINT_COMMAND_MODES[topics.mode], "names": list(names), "command": q.tolist()}
        case CommandKind.TRAJECTORY:
            return {"joint_names": list(names), "points": [trajectory_point_message(q, v, a, topics.horizon)]}
        case CommandKind.ARRAY:
            return {"data": q.tolist()}


def trajectory_point_message(q: Vector, v: Vector, a: Vector, ahead: float = 0.0) -> dict[str, Any]:
    """Message ``trajectory_msgs/JointTrajectoryPoint``.

    Args:
        q: positions (n,) [rad].
        v: velocities (n,) [rad/s].
        a: accelerations (n,) [rad/s^2].
        ahead: time from the start of the trajectory to this point [s].
    """
    return {
        "positions": q.tolist(),
        "velocities": v.tolist(),
        "accelerations": a.tolist(),
        "time_from_start": time_message(ahead),
    }


def time_message(seconds: float) -> dict[str, int]:
    """A time or a duration [s] in the form of a ROS 1 message."""
    whole, rest = divmod(round(1e9 * seconds), 1_000_000_000)
    return {"secs": whole, "nsecs": rest}


def commanded_positions(message: Mapping[str, Any], kind: CommandKind) -> tuple[Any, ...]:
    """Positions in a message that commands an arm; empty for a message without positions."""
    if kind is CommandKind.TRAJECTORY:
        points = message.get("points") or [{}]
        return tuple(points[-1].get("positions") or ())
    return tuple(message.get("command" if kind is CommandKind.JOINT_COMMAND else "data") or ())
