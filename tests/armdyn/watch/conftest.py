"""An arm, and what its sound work looks like."""

import pytest
from watch_work import model, samples, work

from armdyn.watch.sound import measured_sound


@pytest.fixture(scope="session")
def arm():
    return model()


@pytest.fixture(scope="session")
def sound(arm):
    """What six minutes of sound work say."""
    runs = [work(arm, seed) for seed in range(100, 106)]
    return measured_sound(arm, [lambda run=run: samples(run) for run in runs])
