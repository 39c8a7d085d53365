import pytest

import urdf


@pytest.fixture(scope="session")
def robot(baxter: urdf.Robot) -> urdf.Robot:
    return baxter
