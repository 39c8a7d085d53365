import time

import pytest


@pytest.fixture
def until():
    """Waits for a condition, generously: these tests run on busy machines."""

    def wait(condition, patience=30.0):
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.005)

    return wait
