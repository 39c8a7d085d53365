"""Nothing is discovered where nothing is missing."""

import numpy as np

from armdyn.discovery.discover import discover
from armdyn.effects.user import available
from armdyn.pendulum.model import pendulum_model

from ...hidden_effects.pendulum import Setup, record


def test_nothing_is_discovered_where_nothing_is_missing():
    model = pendulum_model(0.368, 0.08)
    run = record("clean", Setup(duration=6.0), np.random.default_rng(3))
    found = discover(model, [run], [], available(model))
    assert not found.findings
    assert found.sentence.startswith("Nothing is missing")
