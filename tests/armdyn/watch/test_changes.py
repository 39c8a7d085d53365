"""A change is told from what scatters with the posture on a sound robot."""

import numpy as np
import pytest

from armdyn.estimation.equations import NormalEquations
from armdyn.watch.changes import FaultFreeBaseline
from armdyn.watch.watched import LOAD_PRIOR, LOAD_UNITS, SharedChange

FRICTION, OFFSET = 0, 2
MORE = 0.3
LOAD = (SharedChange("payload", np.arange(4), LOAD_PRIOR, LOAD_UNITS, (0,) * 4),)


def windows(rng, count, more=0.0):
    """Of one joint that mostly moves one way, whose offset scatters by 1 N m and whose errors by 0.1 N m."""
    parts = []
    for _ in range(count):
        way = np.where(rng.random(50) < rng.uniform(0.2, 0.8), 1.0, -1.0)
        v = way * rng.uniform(0.5, 1.0, 50)
        X = np.stack([way, v, np.ones(50), 5.0 * rng.standard_normal(50)], axis=1)
        r = X @ [more, 0.0, rng.standard_normal(), 0.0] + 0.1 * rng.standard_normal(50)
        parts.append(NormalEquations.of_samples(np.hstack([np.zeros((50, 4)), X]), r, 0.1))
    return NormalEquations.stacked(parts)


def test_friction_is_found_beside_an_offset_that_scatters():
    rng = np.random.default_rng(0)
    baseline = FaultFreeBaseline.of(windows(rng, 200), LOAD, np.zeros(1), 3)
    _, quiet = baseline.scores(windows(rng, 200))
    assert np.sqrt(np.mean(quiet**2, axis=(0, 1))) == pytest.approx(np.ones(4), abs=0.4)
    changed = windows(rng, 200, MORE)
    _, scores = baseline.scores(changed)
    assert np.median(scores[:, 0, FRICTION]) > 4.0
    assert np.median(scores[:, 0, OFFSET]) < 1.5
    found = [baseline.joint_change(changed.only(np.array([k])), 0, FRICTION) for k in range(200)]
    sizes, stds = np.array(found).T
    assert np.median(sizes) == pytest.approx(MORE, abs=0.02)
    assert np.median(np.abs(sizes - MORE) / stds) < 1.5


def test_a_joint_that_never_moves_tells_nothing_and_breaks_nothing():
    still = NormalEquations.of_units(np.zeros((60, 5, 8)), np.zeros((60, 5)), np.ones((60, 5)))
    load, own = FaultFreeBaseline.of(still, LOAD, np.zeros(2), 3).scores(still)
    assert np.isfinite(own).all()
    assert own.max() < 1e-3
    assert load.max() < 1e-3
