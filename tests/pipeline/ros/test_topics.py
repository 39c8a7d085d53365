"""The table [ros] of a settings file."""

import pytest

from armdyn.errors import InputError
from pipeline.ros.topics import CommandKind, positions_in, read_topics, settings_file

UR = """
[ros]
joint_states = "/joint_states"
command = "/joint_group_position_controller/command"
type = "std_msgs/Float64MultiArray"
"""


def test_baxters_own_table():
    topics = read_topics(settings_file("baxter"))
    assert topics.command == "/robot/limb/right/joint_command"
    assert (topics.type, topics.mode) == (CommandKind.JOINT_COMMAND, "raw_position")
    assert topics.command_timeout == 0.1
    assert topics.enabling == "/robot"


def test_another_arm_needs_three_lines(tmp_path):
    file = tmp_path / "ur.toml"
    file.write_text(UR)
    topics = read_topics(file)
    assert topics.type is CommandKind.ARRAY
    assert topics.enabling is topics.timeout is topics.feed_forward is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"there is no table \[ros\]"),
        ("[ros]\ncommand = '/a'", "'joint_states' is missing"),
        (UR + "speed = 1", "unknown key 'speed': did you mean 'speed_ratio'"),
        (UR.replace("/joint_states", "joint_states"), "begins with '/'"),
        (UR.replace("Float64MultiArray", "String"), "choose one of baxter_core_msgs/JointCommand"),
        (UR + "mode = 'torque'", "choose one of position, raw_position"),
        (UR + "command_timeout = 5", "from 0.02 to 1 s"),
        (UR + "command_timeout = nan", "from 0.02 to 1 s"),
        ("[ros", "TOML"),
    ],
)
def test_a_bad_table_is_explained(tmp_path, text, says):
    file = tmp_path / "arm.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=says):
        read_topics(file)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        read_topics(tmp_path / "none.toml")


def test_positions_are_found_in_anybodys_command():
    assert positions_in({"command": [1.0]}, CommandKind.JOINT_COMMAND) == (1.0,)
    assert positions_in({"data": [1.0]}, CommandKind.ARRAY) == (1.0,)
    assert positions_in({"points": [{"positions": [2.0]}, {"positions": [1.0]}]}, CommandKind.TRAJECTORY) == (1.0,)
    assert positions_in({}, CommandKind.TRAJECTORY) == ()
