"""An arm, and what its sound work looks like."""

import pytest
from watch_work import model, samples, work

from armdyn.watch.fault_free import statistics_of_recordings


@pytest.fixture(scope="session")
def arm():
    return model()


@pytest.fixture(scope="session")
def sound(arm):
    """What six minutes of sound work say."""
    runs = [work(arm, seed) for seed in range(100, 106)]
    return statistics_of_recordings(arm, [lambda run=run: samples(run) for run in runs])
