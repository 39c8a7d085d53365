"""What is discovered: nothing where nothing is missing, and what is told and drawn of a law."""

from types import SimpleNamespace

import numpy as np
import pytest

from armdyn.discovery.discover import discover, predicts_better
from armdyn.effects.effect import effect
from armdyn.effects.user import available
from armdyn.identify.missing_force import between
from armdyn.identify.repair import add
from armdyn.identify.study import Study
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

from ...hidden_effects.laws import world
from ...hidden_effects.pendulum import Setup, record


def test_nothing_is_discovered_where_nothing_is_missing():
    model = pendulum_model(0.368, 0.08)
    run = record("clean", Setup(duration=6.0), np.random.default_rng(3))
    found = discover(model, [run], [], available(model))
    assert not found.findings
    assert found.sentence == "Nothing is missing: what is left is noise."


def test_what_stands_still_shows_no_law():
    time, noise = np.arange(0.0, 8.0, 0.02), 1e-3 * np.random.default_rng(1).standard_normal(400)
    run = Run("still", {"swing_angle": Channel(time, noise, "rad")}, {}, {"swing_angle": 1e-3})
    found = discover(pendulum_model(0.368, 0.08), [run], [], [])
    assert found.still
    assert "record a motion" in found.sentence


def test_a_law_is_drawn_over_the_missing_force_without_its_noise():
    """Cubic drag M = -k rate^3 of a pendulum, which no length can make up for."""
    given = world("cubic drag", 3)
    model = pendulum_model(given.length, given.mass)

    @effect("drag", acts_on="string", summary="drag", source="a test")
    def drag(string, k=quantity("N m s^3/rad^3", typical=1e-3, lower=0)):
        return string.with_torque(-k * string.rate**3)

    study = Study(model, given.runs[:1], [], [drag])
    first, fit = study.first(), add(study, [drag]).steps[-1].fit
    (curve,) = (c for c in between(first, fit, law=True) if c.against == "speed")
    (k,) = fit.values[study.problem.of(("drag.k",))]
    torque = -k * curve.x**3 / (given.mass * given.length**2)
    drawn, measured = (np.sqrt(np.mean((y - torque) ** 2)) for y in (curve.law, curve.as_given))
    assert drawn < 0.3 * measured
    assert drawn < 0.1 * np.sqrt(np.mean(torque**2))


@pytest.mark.parametrize(("left", "better"), [([0.5, 0.5], True), ([2.0, 0.1], False), ([], True)])
def test_what_predicts_runs_that_were_not_fitted_no_better_is_not_told(left, better):
    """A curve through seven values once fitted two recordings, and predicted each from the other 14 times worse."""
    blocks = {"as given": [1.0, 1.0] if left else [], "with it": left}
    study = SimpleNamespace(held_out_blocks=lambda fit: [SimpleNamespace(residual=np.array([r])) for r in blocks[fit]])
    steps = [SimpleNamespace(fit="as given"), SimpleNamespace(fit="with it")]
    assert predicts_better(study, SimpleNamespace(steps=steps, last=steps[-1])) is better
