import pytest

import ik
import urdf


@pytest.fixture(scope="session")
def robot() -> urdf.Robot:
    return urdf.load("baxter")


@pytest.fixture(scope="session")
def table(robot: urdf.Robot) -> ik.LineTable:
    return ik.default_table(robot)
