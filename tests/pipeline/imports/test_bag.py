"""ROS bags of every kind hold what was written, with definitions that they carry themselves."""

import shutil

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import get_types_from_msg

from armdyn.errors import InputError
from pipeline.imports import read_foreign
from pipeline.imports.bag import read_bag
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import map_unambiguous_columns
from pipeline.imports.mapping import ColumnEntry, ColumnMap
from pipeline.record import Recorder

from .bags import START, header, joint_state, store_of, write_bag, write_mcap
from .conftest import JOINTS, TIME, motion

OWN = "my_msgs/msg/Cell"


def store_with_own(ros):
    store = store_of(ros)
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 grams\nint8[2] flags\nstring note", OWN))
    return store


def messages(store):
    """Joint states, a wrench, a number and a message of one's own, every 10 ms; each with its topic and time, s."""
    types = store.types
    vector, wrench = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]
    for i, (t, q, v, tau) in enumerate(zip(TIME, *motion(), strict=True)):
        time = START + t
        yield "/joint_states", time, joint_state(store, time, JOINTS, q, v, tau)
        at, zero = header(store, time, i), vector(x=0.0, y=0.0, z=0.0)
        force = wrench(force=vector(x=0.0, y=0.0, z=float(9.0 + q[0])), torque=zero)
        yield "/wrench", time, types["geometry_msgs/msg/WrenchStamped"](header=at, wrench=force)
        yield "/length", time, types["std_msgs/msg/Float64"](data=float(t))
        yield "/cell", time, types[OWN](header=at, grams=1e3 * t, flags=np.array([1, 2], np.int8), note="x")


def write_all(path, plugin=None):
    """All messages 2 ms after they were stamped, in a bag of ROS 2 with a kind of storage, else in one of ROS 1."""
    store = store_with_own(2 if plugin else 1)
    return write_bag(path, store, ((topic, time + 0.002, made) for topic, time, made in messages(store)), plugin)


WAYS = ("bag1", "sqlite3", "mcap")


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """A bag of every kind."""
    folder = tmp_path_factory.mktemp("bags")
    found = [write_all(folder / "a.bag"), *(write_all(folder / kind.name, kind) for kind in StoragePlugin)]
    return dict(zip(WAYS, found, strict=True)) | {"mcap file": next(found[2].glob("*.mcap"))}


@pytest.fixture(params=[*WAYS, "mcap file"])
def bag(request, bags, tmp_path):
    """A copy of each, to be spoiled."""
    own, copy = bags[request.param], tmp_path / bags[request.param].name
    return shutil.copytree(own, copy) if own.is_dir() else shutil.copy(own, copy)


def run_in(bag):
    (foreign,) = read_foreign(bag)
    return run_from_recording(foreign, map_unambiguous_columns(foreign)).run


def test_joint_states_become_a_run_and_what_else_was_sent_is_mapped(bag, joints):
    (foreign,) = read_foreign(bag)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    assert run.joints == JOINTS
    for quantity, values, unit in zip(("q", "v", "tau"), joints, ("rad", "rad/s", "N m"), strict=True):
        for i, joint in enumerate(JOINTS):
            channel = run.channels[f"{quantity}.{joint}"]
            np.testing.assert_allclose(channel.value, values[:, i], atol=1e-12)
            np.testing.assert_allclose(channel.time, TIME, atol=1e-6)  # the header's stamp, not when it arrived
            assert channel.unit == unit
    entries = {
        "/wrench/wrench/force/z": ColumnEntry("load_force", "N", sign=-1.0, offset="10 N"),
        "/cell/grams": ColumnEntry("gripper_z", "mm"),
        "/length/data": ColumnEntry("gripper_x", "m"),
    }
    run = run_from_recording(foreign, ColumnMap(entries)).run
    np.testing.assert_allclose(run.channels["load_force"].value, 1.0 - joints[0][:, 0])
    np.testing.assert_allclose(run.channels["gripper_z"].value, TIME, rtol=1e-6)
    np.testing.assert_allclose(run.channels["gripper_x"].value, TIME)
    assert "/cell/flags/1" in foreign.columns


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("number", ["", "_0"])
def test_a_directory_without_its_metadata_is_a_bag_all_the_same(tmp_path, bags, joints, kind, number):
    bag = shutil.copytree(bags[kind], tmp_path / "walk")
    (bag / "metadata.yaml").unlink()
    (file,) = bag.iterdir()
    file.rename(file.with_stem(f"walk{number}"))
    np.testing.assert_allclose(run_in(bag).channels["q.elbow"].value, joints[0][:, 1], atol=1e-12)


@pytest.mark.parametrize("share", [0.4, 0.7, 0.99])
def test_of_a_bag_that_was_cut_off_all_that_came_before_is_read(bag, share, joints):
    file = bag if bag.is_file() else next(file for file in bag.iterdir() if file.suffix in (".db3", ".mcap"))
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    run = run_in(bag)
    q = run.channels["q.elbow"]
    assert len(q) > 0.5 * share * len(TIME)
    rows = np.round(q.time / 0.01).astype(int)  # a database loses pages in between
    np.testing.assert_allclose(q.value, joints[0][rows, 1], atol=1e-12)
    assert any("not all of it can be read" in note for note in run.warnings) or share == 0.99


@pytest.mark.parametrize("definition", ["float32 grams\nnosuch/Type x", "???", "float32 grams", None])
def test_an_mcap_without_a_profile_of_ros_is_read_but_for_messages_whose_definition_is_wrong(
    definition, tmp_path, joints
):
    path = write_plain_mcap(tmp_path / "a.mcap", {OWN: definition} if definition else {})
    (foreign,) = read_foreign(path)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    np.testing.assert_allclose(run.channels["q.elbow"].value, joints[0][:, 1], atol=1e-12)
    np.testing.assert_allclose(foreign.columns["/plain/cell/force"].value, 2 * TIME)
    assert "/wrench/wrench/force/z" in foreign.columns
    if definition is None:
        np.testing.assert_allclose(foreign.columns["/cell/grams"].value, 1e3 * TIME, rtol=1e-6)
    elif definition != "float32 grams":
        assert "/cell/grams" not in foreign.columns
        assert any("/cell" in note for note in foreign.notes)


def test_what_is_no_bag_says_so(tmp_path, complains):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(range(200)))
    with complains(InputError):
        read_bag(tmp_path / "a.bag")
    with complains(InputError):
        read_bag(tmp_path / "b.bag")


def write_plain_mcap(path, instead):
    """As Foxglove writes it: no profile of ROS, definitions with all that they need, and a topic of JSON."""
    store = store_with_own(2)
    schemas, found = {}, []
    for topic, time, message in messages(store):
        kind = message.__msgtype__
        if topic not in schemas:
            definition = instead.get(kind) or store.generate_msgdef(kind, ros_version=2)[0]
            schemas[topic] = kind, "ros2msg", definition, "cdr"
        found.append((topic, time, bytes(store.serialize_cdr(message, kind))))
    found += [("/plain", START + t, {"cell": {"force": 2 * t}, "name": "a"}) for t in TIME]
    return write_mcap(path, found, schemas)


def test_of_any_message_every_number_that_is_recorded_often_enough_is_a_column(tmp_path):
    many = [
        ("/a", START + 0.1 * i, {"x": [i, {"y": -i}], "on": i > 5, "image": [0] * 65, "says": "x"}) for i in range(10)
    ]
    again = [("/a", START + 0.5, {"x": [99, {"y": 99}], "on": True})]  # published twice
    few = [("/few", START + i, {"x": 1.0}) for i in range(9)]
    odd = [("/odd", 0, b"?")]
    path = write_mcap(tmp_path / "a.mcap", [*odd, *many, *again, *few], {"/odd": ("", "", "", "protobuf")})
    (foreign,) = read_foreign(path)
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
    store, zero = store_of(1), np.zeros(3)
    write_bag(tmp_path / "a.bag", store, (
        (topic, START + 0.1 * i, joint_state(store, 0.0, names, zero + i, zero, zero - 1))  # not stamped
        for topic, count in (("/short", 12), ("/long", 15)) for i in range(count)
    ))  # fmt: skip
    (foreign,) = read_foreign(tmp_path / "a.bag")
    used = {column.channel: name for name, column in foreign.columns.items() if column.channel}
    every = (("position", "q"), ("velocity", "v"), ("effort", "tau"))
    assert used == {f"{q}.{n}": f"/long/{field}/{n}" for field, q in every for n in names}
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    assert set(run.channels) == {f"{q}.{n}" for q in ("q", "tau") for n in names}
    assert sum("holds nothing but zeros: no v." in note for note in run.warnings) == 3
    np.testing.assert_allclose(foreign.columns[f"/long/position/{names[0]}"].time, START + 0.1 * np.arange(15))
    assert sum("/long/position/" in note and "has more samples" in note for note in foreign.notes) == 3
    assert any("UR's drivers" in note for note in foreign.notes) == (names[0] != "a")


def test_a_recording_of_armdyn_needs_no_import(tmp_path, complains):
    recorder = Recorder(tmp_path / "a.mcap", {"load_force": "N"})
    for t in TIME:
        recorder.record("load_force", float(t), 1.0)
    recorder.close()
    with complains(InputError):
        read_foreign(tmp_path / "a.mcap")


def test_a_chunk_that_is_damaged_is_left_out_and_named(tmp_path):
    rng = np.random.default_rng(0)
    states = (
        ("/joint_states", 0.01 * k, {"name": ["a"], "position": [rng.normal()], "effort": [rng.normal()]})
        for k in range(6000)
    )
    path = write_mcap(tmp_path / "a.mcap", states, chunk_size=200_000)
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
