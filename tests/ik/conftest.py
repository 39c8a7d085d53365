import pytest
import yourdfpy

import ik
import urdf


@pytest.fixture(scope="session")
def baxter() -> urdf.Robot:
    return urdf.load("baxter")


@pytest.fixture(scope="session")
def table(baxter: urdf.Robot) -> ik.LineTable:
    return ik.build_line_table(baxter)


@pytest.fixture(scope="session")
def yourdf(baxter: urdf.Robot) -> yourdfpy.URDF:
    """The unmended URDF in a library that shares no code with Pinocchio."""
    return yourdfpy.URDF.load(str(baxter.urdf_path), load_meshes=False)
