import copy
import csv
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.writer import Writer

from armdyn.errors import InputError, UnknownNameError
from armdyn.run import Channel, KnownQuantity, Run, read_run, write_run_csv

DATA = Path(__file__).parents[2].parent / "shared" / "data"
# Logs of servos have columns of their own, such as counts of current: they are for `armdyn import`.
FOREIGN = ("reference", "servo_so101", "servo_xl330")
RECORDINGS = sorted(path for path in DATA.glob("*/*.csv") if path.parent.name not in FOREIGN)
TIME = np.arange(50) / 100
FORCE = 1.0 + np.sin(TIME)


def table(header, *columns, end="\n"):
    rows = (",".join(f"{x:.4f}" for x in row) for row in zip(*columns, strict=True))
    return "\n".join([header, *rows]) + end


GOOD = table("time [s],load_force [N]", TIME, FORCE)


@pytest.fixture
def recording(tmp_path):
    def write(text, sidecar=None):
        path = tmp_path / "swing.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        if sidecar is not None:
            path.with_suffix(".toml").write_text(sidecar, encoding="utf-8")
        return path

    return write


def test_columns_are_read_in_si_units(recording):
    header = "time [ms],load_force [gram_force],swing_angle [deg],q.right_s1 [rad],tau.right_s1 [N m]"
    run = read_run(recording(table(header, TIME * 1000, FORCE, FORCE, FORCE, FORCE)))
    assert run.name == "swing.csv"
    assert {name: channel.unit for name, channel in run.channels.items()} == {
        "load_force": "N",
        "swing_angle": "rad",
        "q.right_s1": "rad",
        "tau.right_s1": "N m",
    }
    np.testing.assert_allclose(run.channel("load_force").time, TIME, rtol=1e-14)
    np.testing.assert_allclose(run.channel("load_force").value, np.round(FORCE, 4) * 9.80665e-3, rtol=1e-14)
    np.testing.assert_allclose(run.channel("swing_angle").value, np.radians(np.round(FORCE, 4)), rtol=1e-14)
    assert run.predictable_channels == ("load_force", "swing_angle", "tau.right_s1")
    assert run.joints == ("right_s1",)


def test_a_sliding_joint_has_metres_and_newtons(recording):
    run = read_run(recording(table("time [s],q.slide [mm],tau.slide [kN]", TIME, FORCE, FORCE)))
    assert run.channel("q.slide").unit == "m"
    assert run.channel("tau.slide").unit == "N"


def test_missing_samples_are_dropped_per_channel(recording):
    text = GOOD.replace("load_force [N]", "load_force [N],swing_angle [rad]").replace("\n0.", ",\n0.")
    text = text.replace("1.0000,\n", "1.0000,\n").rstrip("\n") + ",0.5\n"
    text = text.replace("\n0.0500,1.0500,", "\n0.0500,nan,0.25").replace("\n0.0600,1.0600,", "\n0.0600,,0.3")
    text = text.replace("[rad],\n", "[rad]\n")
    run = read_run(recording(text))
    assert 0.05 not in run.channel("load_force").time
    assert len(run.channel("load_force")) == 48
    np.testing.assert_array_equal(run.channel("swing_angle").time, [0.05, 0.06, 0.49])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("time [s],load_force [N]", '"time [s]", "load_force[N]"'),
        lambda text: text + "\n\n",
        lambda text: text.replace("\n0.1000", "\n\n0.1000"),
        lambda text: text.removesuffix("\n"),
    ],
    ids=["crlf", "byte order mark", "quotes", "blank end", "blank row", "no last newline"],
)
def test_harmless_differences_of_the_file_read_the_same(recording, change):
    run = read_run(recording(change(GOOD)))
    np.testing.assert_array_equal(run.channel("load_force").value, np.round(FORCE, 4))


BAD = {
    "unknown column": GOOD.replace("force", "froce"),
    "misspelt joint channel": GOOD.replace("load_force", "tua.elbow"),
    "no time": table("gripper_x [m],load_force [N]", TIME, FORCE),
    "header without unit": GOOD.replace(" [N]", ""),
    "empty unit": GOOD.replace("[N]", "[]"),
    "unknown unit": GOOD.replace("[N]", "[Nn]"),
    "wrong dimension": GOOD.replace("[N]", "[kg]"),
    "wrong joint dimension": table("time [s],q.a [kg]", TIME, FORCE),
    "joint turns and slides": table("time [s],q.a [m],tau.a [N m]", TIME, FORCE, FORCE),
    "time backwards": table("time [s],load_force [N]", TIME[::-1], FORCE),
    "time repeated": GOOD.replace("\n0.1000", "\n0.0900"),
    "time missing": GOOD.replace("\n0.1000", "\n"),
    "all nan": table("time [s],load_force [N]", TIME, FORCE * np.nan),
    "two samples": table("time [s],load_force [N]", TIME[:2], FORCE[:2]),
    "header only": "time [s],load_force [N]\n",
    "huge value": GOOD.replace("\n0.1000,", "\n0.1000,1e9"),
    "huge in small unit": GOOD.replace("[N]", "[GN]"),
    "infinite": GOOD.replace("\n0.1000,1.0998", "\n0.1000,inf"),
    "no number": GOOD.replace("\n0.1000,", "\n0.1000,x"),
    "cut in a row": GOOD[: len(GOOD) // 2 - 5],
    "cut in a number": GOOD[:-3],
    "cut in the header": "time [s],load_force [N",
    "ragged": GOOD.replace("\n0.1000,", "\n0.1000,3,"),
    "duplicate column": table("time [s],load_force [N],load_force [N]", TIME, FORCE, FORCE),
    "unnamed column": "," + GOOD,
    "only time": table("time [s]", TIME),
    "semicolons": GOOD.replace(",", ";"),
    "empty": "",
    "blank": "\n \n",
    "binary": b"\x00\x01\xff" * 100,
    "not utf-8": GOOD.encode() + b"\xe9,1\n",
    "renamed mcap": b"\x89MCAP0\r\n123",
}
BAD_SIDECARS = {
    "not toml": "mass = ", "number without unit": "[known]\nmass = 0.08", "wrong dimension": '[known]\nlength = "3 kg"',
    "negative mass": '[known]\nmass = "-3 kg"', "unknown noise channel": '[noise]\nload_froce = "3 mN"',
    "noise of another kind": '[noise]\nload_force = "3 mm"', "noise of zero": '[noise]\nload_force = "0 N"',
    "joint noise of another kind": '[noise]\n"q.a" = "3 kg"', "not a table": 'noise = "3 mN"',
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "sidecar"),
    [
        *(pytest.param(text, None, id=name) for name, text in BAD.items()),
        *(pytest.param(GOOD, sidecar, id=f"sidecar: {name}") for name, sidecar in BAD_SIDECARS.items()),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_it(recording, text, sidecar, complains):
    path = recording(text, sidecar)
    with complains(InputError):
        read_run(path)


def test_directory_or_absent_file_is_refused(tmp_path, complains):
    for path in (tmp_path, tmp_path / "a.csv", tmp_path / "a.mcap"):
        with complains(InputError):
            read_run(path)


def test_noise_in_another_kind_of_unit_than_the_joint_is_refused(recording, complains):
    path = recording(table("time [s],q.slide [m]", TIME, FORCE), '[noise]\n"q.slide" = "1 mrad"')
    with complains(InputError):
        read_run(path)


def test_sidecar_gives_noise_and_priors_and_published_values_stay_unread(recording):
    sidecar = """
description = "swing 3"
source = "somewhere"
[noise]
load_force = "3 mN"
tau.elbow = "1 N mm"
[known]
mass = "80 g +/- 0.4 g"
"pivot.radius" = "2 mm"
[published]
length = "0.368 m (from the paper)"
"""
    run = read_run(recording(GOOD, sidecar))
    assert run.description == "swing 3"
    assert run.noise == {"load_force": 0.003, "tau.elbow": 0.001}
    assert run.known == {"mass": KnownQuantity(0.08, 0.0004, "kg"), "pivot.radius": KnownQuantity(0.002, None, "m")}


def test_constant_or_short_signal_is_not_informative(complains):
    run = Run(
        "a", {"load_force": Channel(TIME, 0 * TIME + 1.1, "N"), "swing_angle": Channel(TIME[:5], TIME[:5], "rad")}
    )
    with complains(InputError):
        run.require_varying_channel("load_force")
    with complains(InputError):
        run.require_varying_channel("swing_angle")
    with complains(UnknownNameError):
        run.require_varying_channel("swing_rate")


def test_a_run_cannot_be_changed_nor_its_copy_or_pickle():
    time = TIME.copy()
    run = Run(
        "a", {"load_force": Channel(time, FORCE, "N")}, {"mass": KnownQuantity(0.08, None, "kg")}, {"load_force": 0.003}
    )
    time[0] = -1.0
    assert run.channel("load_force").time[0] == 0.0
    for same in (run, copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        assert same.known == run.known
        with pytest.raises(ValueError, match="read-only"):
            same.channel("load_force").value[0] = 2.0
        with pytest.raises(TypeError):
            same.noise["load_force"] = 1.0


def test_channel_refuses_what_a_recording_cannot_hold(complains):
    for time, value in (([0.0, 0.0], [1.0, 2.0]), ([0.0, 1.0], [1.0, np.nan]), ([0.0, 1.0], [1.0])):
        with pytest.raises(InputError):
            Channel(np.array(time), np.array(value), "N")
    with complains(UnknownNameError):
        Run("a", {"load_forse": Channel(TIME, FORCE, "N")})


@st.composite
def runs(draw):
    def channel(unit):
        size = draw(st.integers(10, 15))
        steps = draw(arrays(float, size, elements=st.floats(1e-6, 10.0)))
        value = draw(arrays(float, size, elements=st.floats(-900.0, 900.0)))
        return Channel(np.cumsum(steps), value, unit)

    names = draw(st.sets(st.sampled_from(["gripper_x", "load_force", "q.a", "tau.a"]), min_size=1))
    units = {"gripper_x": "m", "load_force": "N", "q.a": "rad", "tau.a": "N m"}
    std = st.floats(1e-9, 1e3)
    return Run(
        "swing.csv",
        {name: channel(units[name]) for name in sorted(names)},
        draw(st.dictionaries(st.sampled_from(["mass"]), st.builds(KnownQuantity, std, st.none() | std, st.just("kg")))),
        draw(st.dictionaries(st.sampled_from(sorted(names)), std)),
        draw(st.text(st.characters(blacklist_categories=["Cs"]), max_size=20)),
    )


@settings(max_examples=40)
@given(runs())
def test_a_written_run_reads_back_to_the_last_digit(tmp_path_factory, run):
    path = tmp_path_factory.mktemp("run") / "swing.csv"
    write_run_csv(run, path)
    back = read_run(path)
    assert (back.known, back.noise, back.description) == (run.known, run.noise, run.description)
    assert list(back.channels) == list(run.channels)
    for name, channel in run.channels.items():
        np.testing.assert_array_equal(back.channel(name).time, channel.time)
        np.testing.assert_array_equal(back.channel(name).value, channel.value)
        assert back.channel(name).unit == channel.unit


@settings(max_examples=25)
@given(
    st.sampled_from([("ms", "s", 1e3), ("s", "s", 1.0), ("min", "s", 1 / 60)]),
    st.sampled_from([("mN", 1e3), ("gram_force", 1 / 9.80665e-3), ("N", 1.0), ("kgf", 1 / 9.80665)]),
    arrays(float, 12, elements=st.floats(-100.0, 100.0)),
)
def test_units_of_the_file_do_not_change_the_run(tmp_path_factory, time_unit, force_unit, force):
    path = tmp_path_factory.mktemp("run") / "swing.csv"
    time = np.arange(12) / 100
    header = f"time [{time_unit[0]}],load_force [{force_unit[0]}]"
    rows = [f"{t * time_unit[2]!r},{f * force_unit[1]!r}" for t, f in zip(time.tolist(), force.tolist(), strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    channel = read_run(path).channel("load_force")
    np.testing.assert_allclose(channel.time, time, rtol=1e-14)
    np.testing.assert_allclose(channel.value, force, rtol=1e-14, atol=1e-300)


@settings(max_examples=60)
@given(st.integers(200, len(GOOD) - 1))
def test_a_csv_cut_anywhere_is_refused_or_loses_whole_rows_only(tmp_path_factory, size):
    path = tmp_path_factory.mktemp("run") / "swing.csv"
    path.write_text(GOOD[:size])
    if GOOD[size - 1] == "\n":
        channel = read_run(path).channel("load_force")
        np.testing.assert_array_equal(channel.value, np.round(FORCE, 4)[: len(channel)])
    elif GOOD[size] != "\n":
        with pytest.raises(InputError, match=re.escape(str(path))):
            read_run(path)


def test_writing_to_an_absent_directory_is_refused_and_nothing_is_left(tmp_path, complains):
    run = Run("a", {"load_force": Channel(TIME, FORCE, "N")})
    with complains(InputError):
        write_run_csv(run, tmp_path / "absent" / "a.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not RECORDINGS, reason="the recordings in shared/data are not on this machine")
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_real_recordings_read_as_a_plain_csv_reader_sees_them(path):
    run = read_run(path)
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    assert [cell.split(" [")[0] for cell in header] == ["time", *run.channels]
    expected = np.array(rows, dtype=float)
    for i, channel in enumerate(run.channels.values(), start=1):
        np.testing.assert_array_equal(channel.time, expected[:, 0])
        np.testing.assert_array_equal(channel.value, expected[:, i])
    assert set(run.noise) <= set(run.channels)
    assert set(run.known) <= {"mass", "length"}
    for name in run.predictable_channels:
        run.require_varying_channel(name)


SOUND = {
    "all digits": [repr(x) for x in (0.1 + 0.01 * np.sin(np.arange(60))).tolist()],
    "six figures": [f"{x:.6g}" for x in (0.1 + 0.01 * np.sin(np.arange(60))).tolist()],
    "counts": [str(1000 + round(40 * np.sin(0.3 * k))) for k in range(60)],
    "zeros and ones": ["01"[k // 30] for k in range(60)],
    "exponents": [f"{x:.4e}" for x in (0.1 * np.sin(1 + np.arange(60))).tolist()],
}


@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_file_without_a_last_newline_is_read_and_one_that_is_cut_is_not(recording, kind):
    cells = SOUND[kind]
    text = "time [s],load_force [N]\n" + "\n".join(f"{k / 100:.2f},{cell}" for k, cell in enumerate(cells))
    assert read_run(recording(text)).channel("load_force").value[-1] == float(cells[-1])
    harmless = 9 if kind == "all digits" else 0
    for lost in range(1 + harmless, len(cells[-1])):
        with pytest.raises(InputError, match="row 61, column 'load_force'"):
            read_run(recording(text[:-lost]))
    with pytest.raises(InputError, match="copy it again; if that is its whole last row, end it in a newline"):
        read_run(recording(text[: -len(cells[-1])]))


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_of_a_number_with_all_its_digits_the_last_are_of_no_size(recording, lost):
    cells = SOUND["all digits"]
    text = "time [s],load_force [N]\n" + "\n".join(f"{k / 100:.2f},{cell}" for k, cell in enumerate(cells))
    assert read_run(recording(text[:-lost])).channel("load_force").value[-1] == pytest.approx(
        float(cells[-1]), rel=1e-11
    )


@pytest.mark.parametrize("joint", ["a,b", 'a"b', "a\nb", "a [rad]", "x" * 300, "a\tb"])
def test_a_name_that_would_be_read_back_as_another_is_not_written(tmp_path, joint, complains):
    time = np.arange(20) / 10.0
    run = Run("x", {f"q.{joint}": Channel(time, np.sin(time), "rad")}, {}, {})
    with complains(InputError):
        write_run_csv(run, tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


def test_a_ros_bag_is_no_damaged_run(tmp_path, complains):
    """An intact bag of ROS 2 was once called damaged."""
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"float64[] position")
        topic = writer.register_channel("/joint_states", "cdr", schema, {"offered_qos_profiles": "[]"})
        writer.add_message(topic, 0, b"\x00\x01\x00\x00", 0)
        writer.finish()
    with complains(InputError):
        read_run(tmp_path / "bag.mcap")
