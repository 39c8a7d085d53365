import pytest

import urdf


@pytest.fixture(scope="session")
def baxter() -> urdf.Robot:
    return urdf.load("baxter")
