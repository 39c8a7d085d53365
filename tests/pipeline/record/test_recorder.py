import json
import math
import signal
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from armdyn.errors import InputError, UnknownNameError
from armdyn.recording.mcap_run import read_mcap
from armdyn.run import KnownQuantity, read_run
from pipeline.record import Recorder

CHANNELS = {"gripper_x": "m", "gripper_v": "m/s", "load_force": "N", "q.right_s1": "rad", "estimate.length": "m"}


def record(path, **options):
    """A run of 3 s with a gripper at 100 Hz, a load cell at 80 Hz that starts later, and a slow estimate."""
    with Recorder(path, CHANNELS, **options) as recorder:
        for i in range(1200):
            time = i / 400
            if i % 4 == 0:
                recorder.record("gripper_x", time, 0.1 * math.sin(time))
                recorder.record("gripper_v", time, 0.1 * math.cos(time))
                recorder.record("q.right_s1", time, -0.3 + time / 3)
            if i % 5 == 0 and time > 0.1:
                recorder.record("load_force", time + 1e-4, 0.785 + 0.1 * math.sin(3 * time))
            if i % 200 == 0:
                recorder.record("estimate.length", time, 0.328 + time / 100)
    return recorder


def test_mcap_and_csv_give_the_recorded_numbers_to_the_last_digit(tmp_path):
    path = tmp_path / "trial.mcap"
    options = {
        "description": "swing 3",
        "noise": {"load_force": 0.003},
        "known": {"mass": KnownQuantity(0.08, 0.0004, "kg"), "length": KnownQuantity(0.368, None, "m")},
    }
    recorder = record(path, **options)
    expected = recorder.run()
    assert len(expected.channel("gripper_x")) == 300
    assert list(expected.channels) == ["gripper_x", "gripper_v", "load_force", "q.right_s1"]
    assert "estimate" not in path.with_suffix(".csv").read_text().splitlines()[0]
    from_csv = read_run(path.with_suffix(".csv"))
    path.with_suffix(".toml").unlink()  # the MCAP file alone says as much
    for run in (from_csv, read_run(path)):
        assert list(run.channels) == list(expected.channels)
        for name, channel in expected.channels.items():
            np.testing.assert_array_equal(run.channel(name).time, channel.time)
            np.testing.assert_array_equal(run.channel(name).value, channel.value)
            assert run.channel(name).unit == channel.unit
        assert run.known == options["known"]
        assert run.noise == options["noise"]
        assert run.description == "swing 3"
        assert run.warnings == ()
    estimate = read_mcap(path).channels["estimate.length"]  # of another kind: it stays in the MCAP, beside the run
    np.testing.assert_array_equal(estimate.value, recorder.channel("estimate.length").value)
    assert estimate.unit == "m"


def test_topics_are_json_with_schemas_that_name_channel_and_unit(tmp_path):
    path = tmp_path / "trial.mcap"
    record(path)
    topics, messages = {}, {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            topics[channel.topic] = json.loads(schema.data)
            content = json.loads(message.data)
            assert message.log_time == round(content["time"] * 1e9)
            assert set(content) <= set(topics[channel.topic]["properties"])
            messages.setdefault(channel.topic, []).append(content)
    assert set(topics) == {"/gripper", "/load", "/q", "/estimate"}
    assert topics["/gripper"]["properties"]["v"] == {"type": "number", "description": "gripper_v [m/s]"}
    # Samples of one time travel in one message.
    assert messages["/gripper"][1] == {"time": 0.01, "x": 0.1 * math.sin(0.01), "v": 0.1 * math.cos(0.01)}
    assert len(messages["/gripper"]) == 300


CRASH = """
import os, signal, sys
from pipeline.record import Recorder
recorder = Recorder(sys.argv[1], {"load_force": "N"}, description="crashed")
for i in range(1000):
    recorder.record("load_force", i / 100, 1 + i / 1000)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_program_leaves_all_but_the_last_half_second(tmp_path, complains):
    path = tmp_path / "trial.mcap"
    done = subprocess.run([sys.executable, "-c", CRASH, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    with complains(InputError):
        read_run(path)
    run = read_run(path, recover=True)
    force = run.channel("load_force")
    assert force.time[-1] >= 9.99 - 0.5
    np.testing.assert_array_equal(force.value, 1 + np.arange(len(force)) / 1000)
    assert run.description == "crashed"
    assert run.warnings == (
        f"trial.mcap is cut off, its recording did not end properly; recovered up to {force.time[-1]:.3f} s",
    )


def test_ctrl_c_leaves_a_whole_recording(tmp_path):
    path = tmp_path / "trial.mcap"

    def interrupted():
        with Recorder(path, {"load_force": "N"}) as recorder:
            for i in range(334):
                recorder.record("load_force", i / 100, 1 + i / 1000)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    for name in ("trial.mcap", "trial.csv"):
        assert len(read_run(tmp_path / name).channel("load_force")) == 334


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a recording, and its run."""
    path = record(tmp_path_factory.mktemp("whole") / "trial.mcap").path
    return path.read_bytes(), read_run(path)


share = st.floats(0.0, 0.9999)


@settings(max_examples=40)
@given(part=share)
def test_a_recording_cut_anywhere_is_refused_and_recovered_up_to_the_cut(tmp_path_factory, whole, part):
    data, original = whole
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(InputError) as error:
        read_run(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    try:
        recovered = read_run(path, recover=True)
    except InputError:  # nothing before the cut
        assert part < 0.5
        return
    assert "recovered up to" in recovered.warnings[0]
    for name, channel in recovered.channels.items():
        np.testing.assert_array_equal(channel.value, original.channel(name).value[: len(channel)])


@settings(max_examples=40)
@given(part=share, change=st.integers(1, 255))
def test_a_damaged_recording_gives_its_numbers_or_one_line(tmp_path_factory, whole, part, change):
    data, original = whole
    path, position = tmp_path_factory.mktemp("damaged") / "damaged.mcap", int(part * len(data))
    path.write_bytes(data[:position] + bytes([data[position] ^ change]) + data[position + 1 :])
    try:
        run = read_run(path)
    except InputError:
        return
    for name, channel in original.channels.items():
        np.testing.assert_array_equal(run.channel(name).value, channel.value)


def test_bad_samples_are_left_out_and_counted(tmp_path):
    path = tmp_path / "trial.mcap"
    with Recorder(path, {"load_force": "N"}) as recorder:
        for i in range(20):
            recorder.record("load_force", i / 100, 1.0 + i)
        recorder.record("load_force", 0.19, 5.0)  # repeated
        recorder.record("load_force", 0.15, 5.0)  # late
        recorder.record("load_force", 0.20, math.nan)
        recorder.record("load_force", 0.21, math.inf)
        recorder.record("load_force", math.nan, 5.0)
    assert recorder.dropped == {"load_force": 5}
    assert recorder.run().warnings[0].startswith("load_force: 5 samples left out")
    np.testing.assert_array_equal(read_run(path).channel("load_force").value, 1.0 + np.arange(20))


def test_a_recording_without_samples_leaves_no_csv(tmp_path, complains):
    with Recorder(tmp_path / "trial.mcap", CHANNELS):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["trial.mcap"]
    with complains(InputError):
        read_run(tmp_path / "trial.mcap")


def test_wrong_use_is_refused(tmp_path, complains):
    path = tmp_path / "trial.mcap"
    for place, channels, noise in (
        (path, {"load_force": "mN"}, {}),
        (path, {"estimate.time": "s"}, {}),
        (tmp_path / "absent" / "trial.mcap", {"load_force": "N"}, {}),
        (path, {"load_force": "N"}, {"load_forse": 0.003}),
    ):
        with complains(InputError):
            Recorder(place, channels, noise=noise)
    recorder = Recorder(path, {"load_force": "N"})
    with complains(UnknownNameError):
        recorder.record("load_froce", 0.0, 1.0)
    recorder.close()
    recorder.close()
    with pytest.raises(ValueError, match="is closed"):
        recorder.record("load_force", 0.0, 1.0)
