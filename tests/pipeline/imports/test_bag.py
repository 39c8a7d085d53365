"""ROS bags of every kind hold what was written, with definitions that they carry themselves."""

import json

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from armdyn.errors import InputError
from pipeline.imports import read_foreign
from pipeline.imports.bag import read_bag
from pipeline.imports.conversion import imported
from pipeline.imports.guess import known_columns
from pipeline.imports.mapping import ColumnMap, Entry
from pipeline.record import Recorder

from .conftest import JOINTS, TIME, motion

OWN = "my_msgs/msg/Cell"
START = 1_700_000_000


def store_with_own(stores):
    store = get_typestore(stores)
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 grams\nint8[2] flags\nstring note", OWN))
    return store


def messages(store, has_sequence):
    """Joint states, a wrench and a message of one's own, every 10 ms."""
    types = store.types
    q, v, tau = motion()
    for i, t in enumerate(TIME):
        stamp = types["builtin_interfaces/msg/Time"](sec=START + int(t), nanosec=round((t % 1.0) * 1e9))
        extra = {"seq": i} if has_sequence else {}
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **extra)
        names = list(JOINTS)
        yield (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            t,
            types["sensor_msgs/msg/JointState"](header=header, name=names, position=q[i], velocity=v[i], effort=tau[i]),
        )
        vector = types["geometry_msgs/msg/Vector3"]
        wrench = types["geometry_msgs/msg/Wrench"](force=vector(x=0.0, y=0.0, z=float(9.0 + q[i, 0])),
                                                   torque=vector(x=0.0, y=0.0, z=0.0))  # fmt: skip
        yield (
            "/wrench",
            "geometry_msgs/msg/WrenchStamped",
            t,
            types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=wrench),
        )
        yield "/length", "std_msgs/msg/Float64", t, types["std_msgs/msg/Float64"](data=float(t))
        yield "/cell", OWN, t, types[OWN](header=header, grams=1e3 * t, flags=np.array([1, 2], np.int8), note="x")


def write_bag(path, plugin=None):
    """A bag of ROS 2 with a kind of storage, else one of ROS 1."""
    store = store_with_own(Stores.ROS2_HUMBLE if plugin else Stores.ROS1_NOETIC)
    serialize = store.serialize_cdr if plugin else store.serialize_ros1
    with Writer2(path, version=9, storage_plugin=plugin) if plugin else Writer1(path) as writer:
        connections = {}
        for topic, kind, t, message in messages(store, has_sequence=plugin is None):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], round((START + t + 0.002) * 1e9), serialize(message, kind))
    return path


@pytest.fixture(params=["bag1", "sqlite3", "mcap", "mcap file"])
def bag(request, tmp_path):
    if request.param == "bag1":
        return write_bag(tmp_path / "a.bag")
    if request.param == "sqlite3":
        return write_bag(tmp_path / "a", StoragePlugin.SQLITE3)
    directory = write_bag(tmp_path / "a", StoragePlugin.MCAP)
    return directory if request.param == "mcap" else next(directory.glob("*.mcap"))


def test_joint_states_become_a_run(bag, joints):
    (foreign,) = read_foreign(bag)
    run = imported(foreign, known_columns(foreign)).run
    assert run.joints == JOINTS
    for quantity, values, unit in zip(("q", "v", "tau"), joints, ("rad", "rad/s", "N m"), strict=True):
        for i, joint in enumerate(JOINTS):
            channel = run.channels[f"{quantity}.{joint}"]
            np.testing.assert_allclose(channel.value, values[:, i], atol=1e-12)
            np.testing.assert_allclose(channel.time, TIME, atol=1e-6)  # the header's stamp, not when it arrived
            assert channel.unit == unit


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("number", ["", "_0"])
def test_a_directory_without_its_metadata_is_a_bag_all_the_same(tmp_path, joints, plugin, number):
    bag = write_bag(tmp_path / "walk", plugin)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.iterdir()
    file.rename(file.with_stem(f"walk{number}"))
    (foreign,) = read_foreign(bag)
    run = imported(foreign, known_columns(foreign)).run
    np.testing.assert_allclose(run.channels["q.elbow"].value, joints[0][:, 1], atol=1e-12)


def test_a_message_of_ones_own_and_a_wrench_are_mapped(bag):
    (foreign,) = read_foreign(bag)
    entries = {
        "/wrench/wrench/force/z": Entry("load_force", "N", sign=-1.0, offset="10 N"),
        "/cell/grams": Entry("gripper_z", "mm"),
        "/length/data": Entry("gripper_x", "m"),
    }
    run = imported(foreign, ColumnMap(entries)).run
    np.testing.assert_allclose(run.channels["load_force"].value, 1.0 - motion()[0][:, 0])
    np.testing.assert_allclose(run.channels["gripper_z"].value, TIME, rtol=1e-6)
    np.testing.assert_allclose(run.channels["gripper_x"].value, TIME)
    assert "/cell/flags/1" in foreign.columns


@pytest.mark.parametrize("share", [0.4, 0.6, 0.8, 0.99])
def test_of_a_bag_that_was_cut_off_all_that_came_before_is_read(bag, share, joints):
    files = [bag] if bag.is_file() else [file for file in bag.iterdir() if file.suffix in (".db3", ".mcap")]
    data = files[0].read_bytes()
    files[0].write_bytes(data[: int(share * len(data))])
    (foreign,) = read_foreign(bag)
    found = imported(foreign, known_columns(foreign))
    q = found.run.channels["q.elbow"]
    assert len(q) > 0.5 * share * len(TIME)
    rows = np.round(q.time / 0.01).astype(int)  # a database loses pages in between
    np.testing.assert_allclose(q.value, joints[0][rows, 1], atol=1e-12)
    assert any("not all of it can be read" in note for note in found.run.warnings) or share == 0.99


@pytest.mark.parametrize("definition", ["float32 grams\nnosuch/Type x", "???", "float32 grams"])
def test_a_definition_that_is_wrong_leaves_out_its_messages_alone(definition, tmp_path):
    path = write_plain_mcap(tmp_path / "a.mcap", {OWN: definition})
    (foreign,) = read_foreign(path)
    assert len(imported(foreign, known_columns(foreign)).run.channels["q.elbow"]) == len(TIME)
    assert "/wrench/wrench/force/z" in foreign.columns
    if definition != "float32 grams":
        assert "/cell/grams" not in foreign.columns
        assert any("/cell" in note for note in foreign.notes)


def test_what_is_no_bag_says_so(tmp_path):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(range(200)))
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_bag(tmp_path / "a.bag")
    with pytest.raises(InputError, match="no such file"):
        read_bag(tmp_path / "b.bag")


def write_plain_mcap(path, instead=()):
    """As Foxglove writes it: no profile of ROS, definitions with all that they need, and a topic of JSON."""
    store = store_with_own(Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="", library="a test")
        channels = {}
        for topic, kind, t, message in messages(store, has_sequence=False):
            if topic not in channels:
                definition = dict(instead).get(kind) or store.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            stamp = round((START + t) * 1e9)
            writer.add_message(channels[topic], stamp, bytes(store.serialize_cdr(message, kind)), stamp)
        as_json = writer.register_channel("/plain", "json", 0)
        for t in TIME:
            stamp = round((START + t) * 1e9)
            writer.add_message(as_json, stamp, json.dumps({"cell": {"force": 2 * t}, "name": "a"}).encode(), stamp)
        writer.finish()
    return path


def test_an_mcap_without_a_profile_of_ros_is_read_too(tmp_path, joints):
    (foreign,) = read_foreign(write_plain_mcap(tmp_path / "a.mcap"))
    run = imported(foreign, known_columns(foreign)).run
    np.testing.assert_allclose(run.channels["q.elbow"].value, joints[0][:, 1], atol=1e-12)
    np.testing.assert_allclose(foreign.columns["/plain/cell/force"].value, 2 * TIME)
    np.testing.assert_allclose(foreign.columns["/cell/grams"].value, 1e3 * TIME, rtol=1e-6)


def write_json_mcap(path, *messages):
    """Messages of (topic, s since 1970, content)."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="", library="a test")
        channels = {topic: writer.register_channel(topic, "json", 0) for topic in dict.fromkeys(m[0] for m in messages)}
        odd = writer.register_channel("/odd", "protobuf", 0)
        writer.add_message(odd, 0, b"?", 0)
        for topic, time, content in messages:
            writer.add_message(channels[topic], round(1e9 * time), json.dumps(content).encode(), round(1e9 * time))
        writer.finish()
    return path


def test_of_any_message_every_number_that_is_recorded_often_enough_is_a_column(tmp_path):
    many = [
        ("/a", START + 0.1 * i, {"x": [i, {"y": -i}], "on": i > 5, "image": [0] * 65, "says": "x"}) for i in range(10)
    ]
    again = [("/a", START + 0.5, {"x": [99, {"y": 99}], "on": True})]  # published twice
    few = [("/few", START + i, {"x": 1.0}) for i in range(9)]
    (foreign,) = read_foreign(write_json_mcap(tmp_path / "a.mcap", *many, *again, *few))
    assert list(foreign.columns) == ["/a/x/0", "/a/x/1/y", "/a/on"]
    np.testing.assert_array_equal(foreign.columns["/a/x/1/y"].value, -np.arange(10.0))
    np.testing.assert_allclose(foreign.columns["/a/x/0"].time, START + 0.1 * np.arange(10))
    np.testing.assert_array_equal(foreign.columns["/a/on"].value, np.arange(10) > 5)
    assert foreign.notes == (
        "messages of another encoding (protobuf): /odd left out",
        "fewer than 10 numbers: /few/x: left out",
    )


@pytest.mark.parametrize("names", [("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"), ("a", "b", "c")])
def test_of_two_topics_with_the_same_joints_the_longer_is_used_and_zeros_are_no_measurement(names, tmp_path):
    store, zero = get_typestore(Stores.ROS1_NOETIC), np.zeros(3)
    kind = store.types["sensor_msgs/msg/JointState"]
    with Writer1(tmp_path / "a.bag") as writer:
        for topic, count in (("/short", 12), ("/long", 15)):
            connection = writer.add_connection(topic, kind.__msgtype__, typestore=store)
            for i in range(count):
                stamp = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)  # not stamped
                header = store.types["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="")
                message = kind(header=header, name=list(names), position=zero + i, velocity=zero, effort=zero - 1)
                raw = store.serialize_ros1(message, kind.__msgtype__)
                writer.write(connection, round(1e9 * (START + 0.1 * i)), raw)
    (foreign,) = read_foreign(tmp_path / "a.bag")
    used = {column.channel: name for name, column in foreign.columns.items() if column.channel}
    every = (("position", "q"), ("velocity", "v"), ("effort", "tau"))
    assert used == {f"{q}.{n}": f"/long/{field}/{n}" for field, q in every for n in names}
    run = imported(foreign, known_columns(foreign)).run
    assert set(run.channels) == {f"{q}.{n}" for q in ("q", "tau") for n in names}
    assert sum("holds nothing but zeros: no v." in note for note in run.warnings) == 3
    np.testing.assert_allclose(foreign.columns[f"/long/position/{names[0]}"].time, START + 0.1 * np.arange(15))
    assert sum("/long/position/" in note and "has more samples" in note for note in foreign.notes) == 3
    assert any("UR's drivers" in note for note in foreign.notes) == (names[0] != "a")


def test_a_recording_of_armdyn_needs_no_import(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", {"load_force": "N"})
    for t in TIME:
        recorder.record("load_force", float(t), 1.0)
    recorder.close()
    with pytest.raises(InputError, match="which is a run already"):
        read_foreign(tmp_path / "a.mcap")


def test_a_chunk_that_is_damaged_is_left_out_and_named(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=200_000)
        writer.start("json")
        channel = writer.register_channel("/joint_states", "json", writer.register_schema("x", "jsonschema", b"{}"))
        rng = np.random.default_rng(0)
        for k in range(6000):
            text = json.dumps({"name": ["a"], "position": [rng.normal()], "effort": [rng.normal()]})
            writer.add_message(channel, int(1e7 * k), text.encode(), int(1e7 * k))
        writer.finish()
    data = bytearray(path.read_bytes())
    second = data.find(b"zstd", data.find(b"zstd") + 4)
    data[second + 5000 : second + 5100] = bytes(100)
    path.write_bytes(data)
    (foreign,) = read_foreign(path)
    (account,) = foreign.accounts.values()
    assert 3000 < account.came < 6000
    assert np.nanmax(foreign.columns["/joint_states/position/a"].time) > 59.0
    assert any("chunk that is damaged" in note for note in foreign.notes)
    path.write_bytes(data[: second // 2])  # of the first chunk that was not finished, whole blocks are there
    (foreign,) = read_foreign(path)
    assert any("cut off" in note for note in foreign.notes)
