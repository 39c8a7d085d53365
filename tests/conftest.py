"""What holds for all tests."""

import time

import command
import messages
import pytest
from hypothesis import settings

import ik
import urdf

# How long an example takes says how busy the machine is, not whether the code is right.
settings.register_profile("armdyn", deadline=None)
settings.load_profile("armdyn")


@pytest.fixture
def armdyn(monkeypatch, tmp_path):
    """Run a command in this process and a folder of its own: exit status, standard output, standard error."""
    monkeypatch.chdir(tmp_path)
    return command.called


@pytest.fixture
def refused(armdyn):
    """The same for bad input, which is status 2 and nothing but one line: that line."""
    del armdyn
    return command.refused


@pytest.fixture
def complains(request, tmp_path_factory):
    """``with complains(InputError):`` in place of `pytest.raises`; the sentence is the one kept for the test."""
    return messages.Sentences(request.node.nodeid.removeprefix("tests/"), tmp_path_factory.getbasetemp())


@pytest.fixture(scope="session")
def baxter() -> urdf.Robot:
    return urdf.load("baxter")


@pytest.fixture(scope="session")
def table(baxter: urdf.Robot) -> ik.LineTable:
    return ik.default_table(baxter)


@pytest.fixture
def until():
    """Waits for a condition, generously: these tests run on busy machines."""

    def wait(condition, patience=30.0):
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.003)

    return wait
