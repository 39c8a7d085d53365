"""Runs made in memory: units, shapes, and every problem in one message."""

import numpy as np
import pyarrow
import pytest

from armdyn.errors import InputError
from armdyn.run import Run

TIME = np.arange(20) * 0.01
ANGLES = np.outer(np.linspace(-90.0, 90.0, 20), [1.0, 0.5])


def test_degrees_of_two_joints_become_radians():
    run = Run.from_arrays(TIME, {"q": ANGLES, "tau.b": ANGLES[:, 0]}, joints=["a", "b"], units={"q": "deg"})
    assert run.joints == ("a", "b")
    np.testing.assert_allclose(run.channels["q.b"].value, np.deg2rad(ANGLES[:, 1]))
    assert run.channels["q.b"].unit == "rad"
    assert run.channels["tau.b"].unit == "N m"


def test_a_unit_in_the_name_counts_and_missing_samples_are_left_out():
    force = np.full(20, 800.0)
    force[3] = np.nan
    channel = Run.from_arrays(TIME, {"load_force [mN]": force}).channels["load_force"]
    assert len(channel) == 19
    assert channel.value == pytest.approx(np.full(19, 0.8))
    assert TIME[3] not in channel.time


def test_every_problem_is_told_at_once():
    with pytest.raises(InputError) as caught:
        Run.from_arrays(
            TIME[::-1],
            {"q": ANGLES, "load_forc": TIME, "swing_angle": TIME[:5], "swing_rate": ["a"] * 20, "gripper_x [kg]": TIME},
            joints=["a"],
            units={"tau": "N m"},
        )
    message = str(caught.value)
    assert message.startswith("7 problems: (1) ")
    for part in (
        "time does not increase at sample 1",
        "'q' has shape (20, 2)",
        "did you mean 'load_force'",
        "'swing_angle': has shape (5,)",
        "'swing_rate' does not hold numbers",
        "'kg' is of another kind",
        "a unit is given for 'tau'",
    ):
        assert part in message


class Frame:
    """The part of a data frame that is used: pandas', polars' and pyarrow's are alike in it."""

    def __init__(self, columns, index=None):
        self._columns, self.columns = columns, list(columns)
        if index is not None:
            self.index = index

    def __getitem__(self, name):
        return self._columns[name]


def test_a_data_frame_has_its_time_in_a_column():
    run = Run.from_dataframe(Frame({"time [ms]": 1e3 * TIME, "q.a [deg]": ANGLES[:, 0]}), name="a")
    np.testing.assert_allclose(run.channels["q.a"].time, TIME)
    assert run.name == "a"


def test_a_data_frame_may_have_its_time_in_the_index():
    dates = np.datetime64("2026-01-01T12:00:00") + (TIME * 1e9).astype("timedelta64[ns]")
    run = Run.from_dataframe(Frame({"q.a": ANGLES[:, 0] / 100}, index=dates))
    np.testing.assert_allclose(run.channels["q.a"].time, TIME, atol=1e-9)


def test_an_arrow_table_is_a_data_frame():
    run = Run.from_dataframe(pyarrow.table({"time": TIME, "load_force": TIME}))
    np.testing.assert_array_equal(run.channels["load_force"].value, TIME)


def test_a_frame_without_time_says_so():
    with pytest.raises(InputError, match="no 'time' column"):
        Run.from_dataframe(Frame({"q.a": TIME}))
