"""Detection limits, against recordings whose equations share no code with the models."""

import numpy as np
import pytest
from worlds.pendulum import Setup, record, weighed

from armdyn.effects.catalogue import CATALOGUE
from armdyn.experiments.detection import detection_limit, hidden_effects, rivals_hidden_in
from armdyn.experiments.rivals import NO_EFFECT_NAME
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.units import KnownQuantity

EFFECTS = [CATALOGUE[name] for name in ("pivot_viscous_friction", "sensor_gain", "sensor_drift", "gripper_lag")]


def study_of(hidden, seed):
    run = record("a.csv", Setup(hidden=hidden, duration=8.0, force_noise=5e-3), np.random.default_rng(seed))
    run = weighed(run, KnownQuantity(0.08, 8e-4, "kg"), KnownQuantity(0.368, 3e-3, "m"))
    return make_study(pendulum_model(0.36, 0.08), [run], [], EFFECTS)


def rise(study, name):
    """How much larger chi2 is without an effect than with it."""
    (effect,) = (c for c in study.candidates if c.effect == name)
    return study.first().cost - study.fit_base_with_effects((*study.present, effect)).cost


@pytest.mark.parametrize("name", ["pivot_viscous_friction", "sensor_drift", "gripper_lag"])
def test_an_effect_at_its_detection_limit_shows_in_nearly_every_recording_and_a_quarter_of_it_in_hardly_any(name):
    needed = 2.0 * np.log(100.0 * len(EFFECTS))
    shows, hides = [], []
    for seed in range(2, 10):
        clean = study_of({}, seed)
        (effect,) = (c for c in clean.candidates if c.effect == name)
        limit = detection_limit(clean, clean.first(), effect)
        assert limit.parameter.effect == name
        shows.append(rise(study_of({name: limit.size}, seed), name) > needed)
        hides.append(rise(study_of({name: limit.size / 4.0}, seed), name) > needed)
    assert sum(shows) >= 7  # of 8, each with 95 %
    assert sum(hides) <= 1


def test_what_recordings_may_hide_become_rivals_of_no_effect():
    study = study_of({}, 1)
    hidden = hidden_effects(study)
    assert "sensor_gain" in {c.effect for c in hidden}  # a load weighed to 1 % looks alike
    assert all(limit.size > limit.parameter.typical for limit in hidden.values())
    assert "pivot_viscous_friction" not in {c.effect for c in hidden}
    found = rivals_hidden_in(study, hidden)
    assert found.hypotheses[-1].name == NO_EFFECT_NAME
    assert {h.name for h in found.hypotheses[:-1]} == {c.effect for c in hidden}
