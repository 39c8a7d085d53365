"""Recordings of two joints that swing, written in the formats of others."""

import numpy as np
import pytest

TIME = np.arange(300) * 0.01
JOINTS = ("shoulder", "elbow")


def motion():
    """Positions, velocities and efforts, (n, 2) each, in rad, rad/s, N m."""
    phase = np.outer(TIME, [2.0, 3.0])
    q = np.array([1.2, 0.7]) * np.sin(phase)
    v = np.array([1.2, 0.7]) * np.array([2.0, 3.0]) * np.cos(phase)
    return q, v, 5.0 * np.cos(phase) + 0.3 * v


@pytest.fixture
def joints():
    return motion()
