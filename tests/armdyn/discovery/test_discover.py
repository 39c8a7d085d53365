"""Nothing is discovered where nothing is missing."""

from types import SimpleNamespace

import numpy as np
import pytest

from armdyn.discovery.discover import discover, predicts_better
from armdyn.effects.user import available
from armdyn.pendulum.model import pendulum_model

from ...hidden_effects.pendulum import Setup, record


def test_nothing_is_discovered_where_nothing_is_missing():
    model = pendulum_model(0.368, 0.08)
    run = record("clean", Setup(duration=6.0), np.random.default_rng(3))
    found = discover(model, [run], [], available(model))
    assert not found.findings
    assert found.sentence.startswith("Nothing is missing")


@pytest.mark.parametrize(("left", "better"), [([0.5, 0.5], True), ([2.0, 0.1], False), ([], True)])
def test_what_predicts_runs_that_were_not_fitted_no_better_is_not_told(left, better):
    """A curve through seven values once fitted two recordings, and predicted each from the other 14 times worse."""
    blocks = {"as given": [1.0, 1.0] if left else [], "with it": left}
    study = SimpleNamespace(held_out_blocks=lambda fit: [SimpleNamespace(residual=np.array([r])) for r in blocks[fit]])
    steps = [SimpleNamespace(fit="as given"), SimpleNamespace(fit="with it")]
    assert predicts_better(study, SimpleNamespace(steps=steps, last=steps[-1])) is better
