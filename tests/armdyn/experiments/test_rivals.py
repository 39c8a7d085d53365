"""From a diagnosis to hypotheses; the recordings come from equations of their own."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worlds.pendulum import Setup, record, weighed

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError, UnknownNameError
from armdyn.experiments.hypothesis import PlannedExperiment
from armdyn.experiments.plan import other_experiments
from armdyn.experiments.rivals import (
    NO_EFFECT_NAME,
    require_gripper,
    rival_values_of_worst_parameter,
    rivals_by_name,
    rivals_of_diagnosis,
    rivals_refitted_to,
)
from armdyn.experiments.separation import expected_outcome
from armdyn.identify.diagnose import diagnose
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.channels import Channel
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run

FRICTIONS = [CATALOGUE[n] for n in ("pivot_viscous_friction", "linear_drag", "wind", "path_tilt")]


def study_of(hidden, effects=FRICTIONS, seed=5, noise=5e-3):
    run = record("a.csv", Setup(hidden=hidden, duration=6.0, force_noise=noise), np.random.default_rng(seed))
    run = weighed(run, KnownQuantity(0.08, 8e-4, "kg"), KnownQuantity(0.368, 3e-3, "m"))
    return make_study(pendulum_model(0.36, 0.08), [run], [], effects)


@pytest.fixture(scope="module")
def windy():
    return study_of({"wind": 0.02})


def test_ties_become_hypotheses_with_what_the_runs_say_of_their_values(windy):
    found = rivals_of_diagnosis(windy, diagnose(windy))
    assert found is not None
    assert {h.name for h in found.hypotheses} == {"wind", "path_tilt"}
    assert found.hypotheses[0].misfit == 0.0
    assert 0.0 <= found.hypotheses[1].misfit < 6.0  # else it would be no tie
    assert found.noise["load_force"] == pytest.approx(5e-3, rel=0.15)
    for h in found.hypotheses:
        own = next(i for i, name in enumerate(h.free) if name.startswith(h.name))
        std = np.linalg.inv(h.information)[own, own] ** 0.5
        truth = {"wind": 0.02, "path_tilt": np.arctan(0.02 / (0.08 * 9.81))}[h.name]
        assert abs(h.model.value(h.free[own]) - truth) < 5.0 * std
    again = rivals_refitted_to(windy, [("path_tilt",), ("wind",)])
    assert {h.name: round(h.misfit, 6) for h in again.hypotheses} == {
        h.name: round(h.misfit, 6) for h in found.hypotheses
    }


def test_one_name_stands_against_no_effect(windy):
    found = rivals_by_name(windy, ["wind"])
    assert {h.name for h in found.hypotheses} == {"wind", NO_EFFECT_NAME}
    assert found.hypotheses[0].name == "wind"  # there is wind
    assert found.hypotheses[1].misfit > 20.0


def test_an_effect_that_the_runs_do_not_see_is_as_large_as_they_allow():
    found = rivals_by_name(study_of({}), ["pivot_viscous_friction", "linear_drag"])
    for h in found.hypotheses:
        name = next(n for n in h.free if "." in n)
        size, p = h.model.value(name), h.model.parameters[name]
        assert 0.0 < size <= p.typical  # at 0 both would be the same


def test_what_is_determined_worst_is_asked_for_where_nothing_ties():
    study = study_of({"linear_drag": 0.03}, [CATALOGUE["linear_drag"]], noise=0.02)
    found = rival_values_of_worst_parameter(study, diagnose(study))
    assert found is not None
    first, second = found.hypotheses
    assert "=" in first.name
    assert second.misfit == pytest.approx(4.0)  # two standard deviations away
    angle = PlannedExperiment(
        "angle_sensor", "", other_experiments(found, 5.0)[0].motion, {**found.noise, "swing_angle": 1e-3}
    )
    alone = PlannedExperiment("motion", "", angle.motion, found.noise)
    assert expected_outcome(found.hypotheses, angle).separation > expected_outcome(found.hypotheses, alone).separation


def test_only_what_was_not_done_is_proposed(windy):
    found = rivals_by_name(windy, ["wind", "path_tilt"])
    kinds = [e.kind for e in other_experiments(found, 5.0)]
    assert {"mass", "length", "angle_sensor", "measure", "turn", "rest"} <= set(kinds)
    assert "weigh" not in kinds  # it was, to 1 %
    seen = replace(found, noise={**found.noise, "swing_angle": 5e-3})
    assert "angle_sensor" not in [e.kind for e in other_experiments(seen, 5.0)]
    unweighed = replace(found, last=replace(found.last, known={}))
    assert "weigh" in [e.kind for e in other_experiments(unweighed, 5.0)]


def test_names_that_cannot_be_rivals_are_refused(windy, complains):
    with complains(UnknownNameError):
        rivals_by_name(windy, ["nonsense"])
    arm = SimpleNamespace(base="arm", hangs_from_gripper=False, open_questions=())
    with complains(InputError):
        require_gripper(SimpleNamespace(model=arm, runs=()))
    time = np.arange(20.0)
    free = Run("free.csv", {"swing_angle": Channel(time, np.sin(time), "rad")})
    with complains(InputError):
        require_gripper(SimpleNamespace(model=windy.model, runs=(free,)))
