"""Topics of an arm, from the table ``[ros]`` of its settings file, and the messages of commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

from armdyn.errors import InputError, at
from armdyn.toml_file import read_toml
from pipeline.robot.protocol import Vector
from urdf.loader import SETTINGS_DIRECTORY, known_robots
from urdf.toml_tables import ValueCheck, table_to_dataclass


class CommandKind(Enum):
    """Type of the messages that move the arm."""

    JOINT_COMMAND = "baxter_core_msgs/JointCommand"
    TRAJECTORY = "trajectory_msgs/JointTrajectory"
    ARRAY = "std_msgs/Float64MultiArray"


MODES = {"position": 1, "raw_position": 4}
"""How Baxter takes a ``JointCommand``: the message's constants, by the word of the settings file."""


_Name = Annotated[
    str,
    ValueCheck(lambda name: name[:1] == "/" and name[-1] != "/", "give a name that begins with '/' and ends otherwise"),
]
_Seconds = Annotated[float, ValueCheck(lambda seconds: 0.02 <= seconds <= 1.0, "give a time from 0.02 to 1 s")]


@dataclass(frozen=True)
class RosTopics:
    """Names and types of an arm's topics on ROS.

    Attributes:
        joint_states: topic of type ``sensor_msgs/JointState``.
        command: topic of commands that move the arm.
        type: type of these commands.
        mode: mode of a ``JointCommand``, see `MODES`.
        feed_forward: topic of type ``trajectory_msgs/JointTrajectoryPoint``, with every command; None sends none.
        timeout: topic that sets the longest time without a command, ``std_msgs/Float64``; None for no such topic.
        command_timeout: longest time without a command [s], after which the robot holds its posture.
        speed_ratio: topic that sets the share of the speed limits, ``std_msgs/Float64``; None for no such topic.
        enabling: name space of Baxter's ``state``, ``set_super_enable`` and ``set_super_reset``; None without them.
        horizon: how far ahead the point of a ``JointTrajectory`` is [s].
    """

    joint_states: _Name
    command: _Name
    type: CommandKind = CommandKind.JOINT_COMMAND
    mode: Annotated[str, ValueCheck(MODES.__contains__, f"choose one of {', '.join(MODES)}")] = "raw_position"
    feed_forward: _Name | None = None
    timeout: _Name | None = None
    command_timeout: _Seconds = 0.1
    speed_ratio: _Name | None = None
    enabling: _Name | None = None
    horizon: _Seconds = 0.02


def settings_file(robot: str) -> Path:
    """The settings file of a known robot, or the file with a given name."""
    return SETTINGS_DIRECTORY / f"{robot}.toml" if robot in known_robots() else Path(robot)


def read_topics(file: Path) -> RosTopics:
    """The table ``[ros]`` of a robot's settings file.

    Raises:
        InputError: the table is missing, or an entry has the wrong form.
    """
    table = read_toml(file, "; give a robot's settings file").get("ros")
    if not isinstance(table, dict):
        raise InputError(f"{file}: there is no table [ros]; see urdf/robots/baxter.toml for an example")
    with at(file):
        return table_to_dataclass(RosTopics, table, "[ros]")


def command_message(topics: RosTopics, names: Sequence[str], q: Vector, v: Vector, a: Vector) -> dict[str, Any]:
    """Message that commands the arm to positions, velocities and accelerations (n,) [rad, s]."""
    match topics.type:
        case CommandKind.JOINT_COMMAND:
            return {"mode": MODES[topics.mode], "names": list(names), "command": q.tolist()}
        case CommandKind.TRAJECTORY:
            return {"joint_names": list(names), "points": [point_message(q, v, a, topics.horizon)]}
        case CommandKind.ARRAY:
            return {"data": q.tolist()}


def point_message(q: Vector, v: Vector, a: Vector, ahead: float = 0.0) -> dict[str, Any]:
    """A ``trajectory_msgs/JointTrajectoryPoint`` that is to be reached after some seconds."""
    return {
        "positions": q.tolist(),
        "velocities": v.tolist(),
        "accelerations": a.tolist(),
        "time_from_start": time_message(ahead),
    }


def time_message(seconds: float) -> dict[str, int]:
    """A time or a duration as a ROS message."""
    whole, rest = divmod(round(1e9 * seconds), 1_000_000_000)
    return {"secs": whole, "nsecs": rest}


def positions_in(message: Mapping[str, Any], kind: CommandKind) -> tuple[Any, ...]:
    """Positions that a command message of any sender requests; empty where it requests none."""
    if kind is CommandKind.TRAJECTORY:
        points = message.get("points") or [{}]
        return tuple(points[-1].get("positions") or ())
    return tuple(message.get("command" if kind is CommandKind.JOINT_COMMAND else "data") or ())
