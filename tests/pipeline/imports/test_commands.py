"""What joints were told, beside where they went: LeRobot's actions, and topics of commands in bags."""

import json

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import get_types_from_msg

from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns

from .bags import START, header, joint_state, store_of, write_bag
from .conftest import JOINTS, TIME, motion

LATE = 0.005
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
DEFINITIONS = {
    "trajectory_msgs/msg/JointTrajectoryPoint": "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\n"
    "float64[] effort\nbuiltin_interfaces/Duration time_from_start",
    "trajectory_msgs/msg/JointTrajectory": "std_msgs/Header header\nstring[] joint_names\n"
    "trajectory_msgs/JointTrajectoryPoint[] points",
    CONTROLLER: "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint desired\n"
    "trajectory_msgs/JointTrajectoryPoint actual\ntrajectory_msgs/JointTrajectoryPoint error",
}
"""As the messages' packages have them, of ROS 1 and 2 but for how they write a duration."""


def commands() -> np.ndarray:
    """(n, 2) rad: every fourth sample something new."""
    return np.repeat(motion()[0][::4] + 0.05, 4, axis=0)[: len(TIME)]


@pytest.mark.parametrize("names", ["{0}.pos", "main_{0}", ""])
def test_the_actions_of_a_lerobot_data_set_are_what_the_joints_were_told(names, tmp_path):
    q, told = motion()[0], commands()
    about = {"dtype": "float32", "shape": [2], **({"names": [names.format(j) for j in JOINTS]} if names else {})}
    rows = {name: [list(row) for row in np.rad2deg(x)] for name, x in (("observation.state", q), ("action", told))}
    for folder in ("meta", "data"):
        (tmp_path / folder).mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps({"fps": 100, "features": dict.fromkeys(rows, about)}))
    rows |= {"timestamp": TIME.astype(np.float32), "episode_index": np.zeros(len(TIME), int)}
    parquet.write_table(pyarrow.table(rows), tmp_path / "data/episode_000000.parquet")
    recordings = read_foreign(tmp_path)
    found = guess_map(recordings)
    states, actions = ([e for c, e in found.entries.items() if c.startswith(s)] for s in ("observation", "action"))
    assert [e.channel for e in actions] == [e.channel.replace("q.", "q_cmd.") for e in states]
    assert len(actions) == len(JOINTS)
    run = run_from_recording(recordings[0], found).run
    for i, entry in enumerate(actions):
        assert entry.check == states[i].check  # degrees or radians: answered of both
        np.testing.assert_allclose(run.channels[entry.channel].value, told[:, i], atol=1e-6)


def test_commands_beside_torques_stay_out(tmp_path):
    q, _, tau = motion()
    columns = {"time": TIME, **{f"q_{j}": q[:, i] for i, j in enumerate(JOINTS)}}
    columns |= {f"{kind}_{j}": tau[:, i] for i, j in enumerate(JOINTS) for kind in ("torque", "q_target")}
    header = ",".join(columns)
    np.savetxt(tmp_path / "a.csv", np.column_stack(list(columns.values())), delimiter=",", header=header, comments="")
    found = guess_map(read_foreign(tmp_path / "a.csv"))
    assert {entry.channel.partition(".")[0] for entry in found.entries.values()} == {"q", "tau"}


def command(store, kind: str, told, time):
    """A command: a trajectory of one point, a controller's state, or joint states under a name of their own."""
    if kind == "sensor_msgs/msg/JointState":
        return joint_state(store, time, JOINTS, told)
    types = store.types
    duration = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=10_000_000)

    def point(positions):
        own = {"positions": positions, "velocities": np.zeros(2), "accelerations": np.zeros(0), "effort": np.zeros(0)}
        return types["trajectory_msgs/msg/JointTrajectoryPoint"](**own, time_from_start=duration)

    parts = {"points": [point(told)]}
    if kind == CONTROLLER:
        parts = {"desired": point(told), "actual": point(told - 0.05), "error": point(0.0 * told + 0.05)}
    return types[kind](header=header(store, time), joint_names=list(JOINTS), **parts)


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("/joint_trajectory_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
        ("/arm_controller/state", CONTROLLER),
        ("/joint_command", "sensor_msgs/msg/JointState"),
        ("/leader/joint_states", "sensor_msgs/msg/JointState"),
    ],
)
@pytest.mark.parametrize("ros", [1, 2])
def test_a_topic_of_commands_is_what_the_joints_were_told_with_its_own_stamps(topic, kind, ros, tmp_path):
    store = store_of(ros)
    for name, text in DEFINITIONS.items():
        if name not in store.types:
            text = text if ros == 2 else text.replace("builtin_interfaces/Duration", "duration")
            store.register(get_types_from_msg(text, name))
    told, (q, v, _) = commands(), motion()
    messages = []
    for i, time in enumerate(START + TIME):
        messages.append(("/joint_states", time, joint_state(store, time, JOINTS, q[i], v[i])))
        if i % 4 == 0:
            messages.append((topic, time + LATE, command(store, kind, told[i], time + LATE)))
    path = tmp_path / ("a" if ros == 2 else "a.bag")
    write_bag(path, store, messages, StoragePlugin.MCAP if ros == 2 else None)
    (foreign,) = read_foreign(path)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    for i, joint in enumerate(JOINTS):
        channel = run.channels[f"q_cmd.{joint}"]
        np.testing.assert_allclose(channel.time, TIME[::4] + LATE, atol=1e-5)
        np.testing.assert_allclose(channel.value, told[::4, i], atol=1e-9)
        # It holds until the next stamp: between two of them it is the first one's.
        assert channel.zero_order_hold_values(np.array([TIME[4] + LATE + 0.03]))[0] == pytest.approx(told[4, i])
        np.testing.assert_allclose(run.channels[f"q.{joint}"].value, motion()[0][:, i], atol=1e-9)


def test_joint_states_of_a_leader_alone_are_where_it_went(tmp_path):
    store, path, topic = store_of(2), tmp_path / "a", "/leader/joint_states"
    states = ((topic, t, joint_state(store, t, JOINTS, q)) for t, q in zip(START + TIME, motion()[0], strict=True))
    write_bag(path, store, states, StoragePlugin.MCAP)
    (foreign,) = read_foreign(path)
    assert set(run_from_recording(foreign, map_unambiguous_columns(foreign)).run.channels) == {
        f"q.{joint}" for joint in JOINTS
    }
