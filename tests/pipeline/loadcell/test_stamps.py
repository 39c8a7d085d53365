import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.loadcell.cell import SMALLEST_STEP, ReceptionTimes


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 20)), min_size=1))
def test_times_strictly_increase_and_are_not_in_the_future(pieces):
    times, now, stamps = ReceptionTimes(), 100.0, []
    for pause, count in pieces:
        now += pause
        new = times.stamp(now, count)
        assert len(new) == count
        stamps += new
        # Only a clock that stands still pushes them ahead, by a microsecond each.
        assert all(stamp <= now + len(stamps) * SMALLEST_STEP for stamp in new)
    assert np.all(np.diff(stamps) > 0)


def test_a_sample_that_comes_alone_has_the_time_of_its_reception():
    times = ReceptionTimes()
    assert [times.stamp(now, 1)[0] for now in (1.0, 1.01, 1.5, 1.51)] == [1.0, 1.01, 1.5, 1.51]


def test_samples_collected_by_an_adapter_are_dated_back_to_when_they_came():
    times = ReceptionTimes()
    for k in range(50):
        times.stamp(0.01 * k, 1)
    np.testing.assert_allclose(times.stamp(0.54, 5), [0.50, 0.51, 0.52, 0.53, 0.54], atol=1e-9)


def test_samples_behind_a_long_silence_are_not_spread_over_it():
    times = ReceptionTimes()
    for k in range(50):
        times.stamp(0.01 * k, 1)
    np.testing.assert_allclose(times.stamp(5.0, 3), [4.98, 4.99, 5.0], atol=1e-9)


def test_the_rate_is_that_of_the_samples():
    times = ReceptionTimes()
    assert times.rate == 0.0
    for k in range(500):
        times.stamp(k / 80, 1)
    np.testing.assert_allclose(times.rate, 80.0)
    for k in range(200):
        times.stamp(500 / 80 + k / 10, 1)
    np.testing.assert_allclose(times.rate, 10.0)
