from dataclasses import replace

import numpy as np
import pytest

import urdf
from ik.volume import TargetGrid


@pytest.fixture(scope="session")
def small(baxter: urdf.Robot) -> TargetGrid:
    """Two orientations, a part of it out of reach."""
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    rotations = np.array([baxter.line.rotation, turn @ baxter.line.rotation])
    return TargetGrid(np.array([0.6, -0.65, -0.3]), np.array([0.95, -0.2, -0.02]), (30, 40, 28), rotations)


@pytest.fixture(scope="session")
def other(baxter: urdf.Robot) -> urdf.Robot:
    return replace(baxter, fingerprint="0" * 64)
