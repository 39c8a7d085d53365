"""A channel is sign * scale * value * (unit) + offset, over the gear; it does not matter how the file is written."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armdyn.errors import InputError
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.foreign import ForeignColumn, ForeignRecording
from pipeline.imports.mapping import ColumnEntry, ColumnMap, column_map_toml, read_map
from pipeline.imports.stamps import MISSING_STAMP, REPEATED_STAMP

UNITS = {
    "q.a": {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3},
    "v.a": {"rad/s": 1.0, "rpm": np.pi / 30},
    "tau.a": {"N m": 1.0, "mN m": 1e-3},
    "load_force": {"N": 1.0, "gram_force": 9.80665e-3},
    "gripper_x": {"m": 1.0, "mm": 1e-3},
}
SI = {channel: next(iter(units)) for channel, units in UNITS.items()}
GEARED = {"q.a": -1, "v.a": -1, "tau.a": 1}
numbers = st.floats(-100.0, 100.0, allow_subnormal=False)


@st.composite
def entries(draw, channel):
    entry = ColumnEntry(
        channel,
        draw(st.sampled_from(sorted(UNITS[channel]))),
        sign=draw(st.sampled_from([1.0, -1.0])),
        scale=draw(st.sampled_from([1.0, 0.3, 2.0])),
        offset=draw(st.just("") | numbers.map(lambda x: f"{x:.3f} {SI[channel]}")),
        gear_ratio=draw(st.sampled_from([1.0, 0.5, 100.0])) if channel in GEARED else 1.0,
        late=draw(st.sampled_from(["", "20 ms", "-0.5 s"])),
    )
    current = channel == "tau.a" and draw(st.booleans())
    return replace(entry, unit="mA", torque_constant="0.12 N m/A") if current else entry


@settings(max_examples=60)
@given(data=st.data(), reordered=st.booleans())
def test_every_channel_is_what_its_line_says_whatever_the_order_of_lines_and_columns(tmp_path_factory, data, reordered):
    """Rows without a time, and those of the row before, are left out; so are missing samples, channel by channel."""
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    steps = rng.choice([0.0, 1.0, 2.0], 40, p=[0.2, 0.4, 0.4])
    stamps = np.where(rng.random(40) < 0.1, np.nan, np.cumsum(steps))
    mapping = {f"column {channel}": data.draw(entries(channel)) for channel in UNITS}
    values = {name: np.where(rng.random(40) < 0.1, np.nan, rng.uniform(-5.0, 5.0, 40)) for name in mapping}
    columns = {"t": ForeignColumn(10.0 * stamps), **{name: ForeignColumn(value) for name, value in values.items()}}
    if reordered:
        columns, mapping = dict(reversed(columns.items())), dict(reversed(mapping.items()))
    path = tmp_path_factory.mktemp("map") / "map.toml"
    path.write_text(column_map_toml(ColumnMap(mapping, "t", "ms", why="a\nguess")))
    assert read_map(path)[""].entries == mapping
    found = run_from_recording(ForeignRecording("a", columns), read_map(path)[""])
    run, (account,) = found.run, found.accounts

    with_time = np.flatnonzero(np.isfinite(stamps))
    rows = with_time[np.diff(stamps[with_time], prepend=-np.inf) > 0.0]
    expected = {}
    for name, e in mapping.items():
        factor = 0.12e-3 if e.torque_constant else UNITS[e.channel][e.unit]
        factor *= e.sign * e.scale * e.gear_ratio ** GEARED.get(e.channel, 0)
        value = factor * values[name][rows] + (float(e.offset.split()[0]) if e.offset else 0.0)
        late = {"": 0.0, "20 ms": 0.02, "-0.5 s": -0.5}[e.late]
        there = np.isfinite(value)
        expected[e.channel] = 0.01 * stamps[rows][there] - late, value[there]
    first = min(time[0] for time, _ in expected.values())
    assert list(run.channels) == [e.channel for e in mapping.values()]
    for channel, (time, value) in expected.items():
        np.testing.assert_allclose(run.channels[channel].time, time - first, atol=1e-12)
        np.testing.assert_allclose(run.channels[channel].value, value, atol=1e-12)
        assert run.channels[channel].unit == SI[channel]
    assert (account.came, account.kept) == (40, len(rows))
    lost = {MISSING_STAMP: 40 - len(with_time), REPEATED_STAMP: len(with_time) - len(rows)}
    assert account.left_out == {why: count for why, count in lost.items() if count}


DATES = [
    (1.7e9, datetime(2023, 11, 14, 22, 13, 20)), (946684800.0, datetime(2000, 1, 1)), (946684799.0, None),
    (4102444800.0, None), (12.0, None),
]  # fmt: skip
"""s since 1970; the last but one is 2100."""


@pytest.mark.parametrize(("stamp", "recorded"), DATES)
def test_stamps_since_1970_are_the_date_of_the_recording(stamp, recorded):
    time = stamp + 0.01 * np.arange(20)
    columns = {"t": ForeignColumn(time, "s"), "swing_angle": ForeignColumn(np.sin(time), "rad")}
    run = run_from_recording(
        ForeignRecording("a", columns), ColumnMap({"swing_angle": ColumnEntry("swing_angle")}, "t")
    ).run
    assert run.recorded == recorded
    assert run.channels["swing_angle"].time[0] == 0.0


IMPOSSIBLE = [
    (ColumnEntry("load_force", "N", gear_ratio=2.0), 20), (ColumnEntry("q.a", "A", torque_constant="1 N m/A"), 20),
    (ColumnEntry("load_force", "N"), 9),
]  # fmt: skip


@pytest.mark.parametrize(("entry", "count"), IMPOSSIBLE)
def test_a_line_that_cannot_be_is_told(entry, count, complains):
    value = ForeignColumn(np.where(np.arange(20) < count, 1.0, np.nan))
    foreign = ForeignRecording("a", {"t": ForeignColumn(np.arange(20.0)), "x": value})
    with complains(InputError):
        run_from_recording(foreign, ColumnMap({"x": entry}, "t"))
