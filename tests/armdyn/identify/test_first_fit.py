"""The first fit finds where each run's motion began, in what users record."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import situations

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import chi2_sum
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on not in ("joint", "drive"))
LOST_EASILY = (
    "pull_and_release", "release_unweighed", "release_2_rad", "near_upright", "late_motion", "mid_swing", "large_swing",
    "gap_and_jitter", "20_hz", "spikes", "clipped", "several_masses",
)  # fmt: skip


def recorded(name, seed=3, **hidden):
    return situations.recorded(situations.SITUATIONS[name], hidden, np.random.default_rng(seed))


def model_for(name, *effects):
    situation = situations.SITUATIONS[name]
    model = pendulum_model(0.95 * np.mean(situation.length), 1.1 * np.mean(situation.mass))
    for effect in effects:
        model = model.with_effect(CATALOGUE[effect])
    return model


@pytest.mark.parametrize("name", LOST_EASILY)
def test_the_start_of_the_swing_is_found(name):
    runs = recorded(name, quadratic_drag=0.01).runs
    assert make_study(model_for(name, "quadratic_drag"), runs, [], []).first().chi2_per_sample < 1.2


@pytest.mark.parametrize("seed", [2, 3])
def test_friction_that_brakes_the_first_swing_does_not_hide_a_start_near_the_upright(seed):
    runs = recorded("near_upright", seed, pivot_viscous_friction=1.2e-3).runs
    assert make_study(model_for("near_upright", "pivot_viscous_friction"), runs, [], []).first().chi2_per_sample < 1.2


@pytest.mark.parametrize(
    ("name", "hidden", "seed"),
    [
        ("near_upright", {"pivot_viscous_friction": 1.2e-3}, 7),
        ("near_upright", {"angle_offset": 0.02}, 1),
        ("heavy", {"sensor_bias": 1.25}, 3),  # N, of a cell that carries 5 kg: a hundred typical offsets
    ],
)
def test_what_is_far_from_small_is_named(name, hidden, seed):
    rivals = "pivot_viscous_friction pivot_coulomb_friction quadratic_drag wind angle_offset angle_gain sensor_bias"
    effects = [CATALOGUE[name] for name in rivals.split()]
    found = diagnose(make_study(model_for(name), recorded(name, seed, **hidden).runs, [], effects))
    assert {effect.effect for effect in found.search.last.effects} == set(hidden)


def test_a_load_that_was_pulled_and_released_tells_its_start_and_length():
    truth = recorded("pull_and_release")
    found = compare(make_study(model_for("pull_and_release"), truth.runs, [], []))
    assert found.explained
    assert found.undetermined == ()
    assert abs(found.parameters["length"].value - truth.length) < 4 * found.parameters["length"].std
    angle = found.parameters["initial_angle[r0.csv]"]
    assert abs(abs(truth.starts[0][0]) - angle.value) < 4 * angle.std


def test_of_two_mirror_images_the_one_with_a_positive_angle_is_taken():
    truth = recorded("pull_and_release", seed=2)
    first = make_study(model_for("pull_and_release"), truth.runs, [], []).first()
    angles = first.values[first.problem.mask_of_unknowns(["initial_angle"])]
    assert np.all(angles > 0)
    assert any(start[0] < 0 for start in truth.starts)


def test_weak_priors_make_a_new_problem():
    truth = recorded("pull_and_release")
    problem = Problem(model_for("pull_and_release"), truth.runs, {(f"r{k}.csv", "load_force"): 3e-3 for k in range(2)})
    weights = problem.prior_weight.copy()
    held = problem.with_weak_priors(problem.start_values())
    assert np.all(held.prior_weight > 0)
    assert np.array_equal(problem.prior_weight, weights)


def test_a_held_out_run_keeps_the_mass_that_was_weighed_for_it():
    runs = recorded("several_masses").runs
    study = make_study(model_for("several_masses"), runs[:1], runs[1:], [])
    blocks = study.held_out_blocks(study.first())
    assert chi2_sum(blocks) < 1.2 * sum(len(block.residual) for block in blocks)


def test_where_the_gripper_moved_unseen_a_run_is_cut_and_time_goes_on():
    run = recorded("gap_and_jitter").runs[0]
    first, second = model_for("gap_and_jitter").split_into_pieces(run)
    assert second.began == 0.0
    assert "while no position was recorded" in first.warnings[0]
    assert second.channels["load_force"].time[0] > first.channels["load_force"].time[-1] + 1.9


def test_a_gripper_that_rests_in_a_gap_cuts_nothing():
    time = np.delete(np.arange(0.0, 4.0, 0.01), slice(100, 300))
    still = Channel(time, np.full(len(time), 0.1), "m")
    run = Run("a.csv", {"gripper_x": still, "load_force": Channel(time, np.cos(time), "N")})
    assert model_for("plain").split_into_pieces(run) == (run,)


def test_what_was_left_out_is_said():
    runs = recorded("spikes").runs
    found = compare(make_study(model_for("spikes"), runs, [], []))
    assert found.explained
    assert found.left_out[0].startswith("r0.csv: load_force: 5 of 1500 samples far from its neighbours left out")


def test_one_weighing_for_all_runs_is_one_unknown():
    runs = recorded("plain").runs
    other = replace(runs[1], known={**runs[1].known, "mass": KnownQuantity(0.2, 1e-3, "kg")})
    names = [c.name for c in make_study(model_for("plain"), [runs[0], other], [], []).problem.columns]
    assert "mass[r1.csv]" in names
    assert "mass" in [c.name for c in make_study(model_for("plain"), runs, [], []).problem.columns]
