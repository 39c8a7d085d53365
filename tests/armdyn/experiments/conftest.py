import pytest

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find


@pytest.fixture(scope="session")
def shoulder():
    """Three joints of Baxter's right arm, the others at their zero."""
    return arm_model(robot="baxter", joints=["right_s0", "right_s1", "right_e0"])


@pytest.fixture(scope="session")
def baxter():
    return arm_model(robot="baxter")


@pytest.fixture(scope="session")
def effects():
    """Effects by a list of names with blanks in between."""
    return lambda names: [find(name) for name in names.split()]
