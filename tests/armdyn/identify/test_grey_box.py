"""Runs around their measured motion, held against dense linear algebra, finite differences and a world of its own."""

import numpy as np
import pytest
from worlds import dry_swing

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import diagnose
from armdyn.identify.problem import Problem
from armdyn.identify.repair import add
from armdyn.identify.state_space.grey_box import GreyBox
from armdyn.identify.state_space.grey_run import RunNoise
from armdyn.identify.state_space.innovations import (
    ColouredNoise,
    add_channels,
    filter_run,
    smooth_run,
)
from armdyn.identify.state_space.kalman import PIECES_PER_BLOCK, kalman_covariances, semidefinite_cholesky
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.physics.pieces import MotionPieces
from armdyn.physics.simulated import REST_AMPLITUDE_SHARE, rest_time
from armdyn.run import Channel, Run

LENGTH = 0.4
EFFECTS = [effect for effect in CATALOGUE.values() if effect.acts_on not in ("joint", "drive")]


def swing(
    amplitude, seconds, *, viscous=0.0, coulomb=0.0, quadratic=0.0, reach=0.0, noise=1e-3, rate=100.0, seed=0,
    name="a.csv",
):  # fmt: skip
    """A swing with frictions in acceleration units, below a gripper that moves to and fro by `reach`, m."""
    time, pace = np.arange(0.0, seconds, 1.0 / rate), 3.7
    frictions = {"pivot_viscous_friction": viscous, "pivot_coulomb_friction": coulomb, "quadratic_drag": quadratic}
    load = dry_swing.Pendulum(LENGTH, LENGTH**-2, frictions | {"quadratic_drag": quadratic * LENGTH**-3})

    def gripper(t):
        return reach * np.array([np.sin(pace * t), pace * np.cos(pace * t), -(pace**2) * np.sin(pace * t)])

    angle = dry_swing.swing(load, (amplitude, 0.0), dry_swing.Push(gripper if reach else None), time).angle
    angle = angle + noise * np.random.default_rng(seed).normal(size=len(time))
    nodes = time - 0.4 / rate  # samples between them depend on two pieces where these meet
    moved = {"gripper_x": Channel(nodes, gripper(nodes)[0], "m")} if reach else {}
    return Run(name, {**moved, "swing_angle": Channel(time, angle, "rad")})


def box_of(run, effects=("quadratic_drag", "angle_skew"), length=LENGTH):
    model = pendulum_model(length, 0.2, [CATALOGUE[name] for name in effects])
    problem = Problem(model, [run], {(run.name, "swing_angle"): 1e-3})
    none = np.zeros(len(problem.columns), dtype=bool)
    return GreyBox(problem, problem.start_values(), 1, none), problem


def test_derivatives_of_a_motion_in_pieces_are_those_of_finite_differences():
    run = swing(0.8, 4.0)
    model = pendulum_model(LENGTH, 0.2, [CATALOGUE["quadratic_drag"], CATALOGUE["angle_skew"]])
    pieces, theta = MotionPieces(model, run, 0.6), model.theta()
    theta[list(model.names).index("quadratic_drag.coefficient")] = 0.01
    states = pieces.states(theta, model.measured_motion(run, pieces.starts, theta, 1.27))
    found = pieces.linearise(theta, states)
    samples = found.samples["swing_angle"]
    for k in range(states.shape[1]):
        step = 1e-6 * np.eye(states.shape[1])[k]
        there, before = (pieces.linearise(theta, states + sign * step) for sign in (1, -1))
        assert np.allclose(
            (there.end_states - before.end_states) / 2e-6, found.transition[:, :, k], rtol=1e-5, atol=1e-7
        )
        moved = (there.samples["swing_angle"].predicted - before.samples["swing_angle"].predicted) / 2e-6
        assert np.allclose(moved, samples.by_state[:, k], rtol=1e-5, atol=1e-6)
    for j, name in enumerate(model.names):
        if name.startswith("initial"):
            continue
        step = 1e-5 * model.parameters[name].typical * np.eye(len(theta))[j]
        there, before = (pieces.linearise(theta + sign * step, states) for sign in (1, -1))
        by_theta = (there.end_states - before.end_states) / (2 * step[j])
        assert np.allclose(by_theta, found.by_theta[:, :, j], rtol=1e-4, atol=1e-5 * np.abs(by_theta).max() + 1e-12)


@pytest.mark.parametrize("colour", [ColouredNoise(), ColouredNoise(9.0, 0.2)])
def test_the_filter_gives_the_likelihood_of_the_dense_covariance(colour):
    box, problem = box_of(swing(0.6, 3.0))
    (around,) = box.linearise(box.initial_point(problem.start_values()))
    noise = RunNoise(0.05, (1.3,), (colour,))
    found = around.innovations([noise], np.array([noise.process_noise_std]))
    residual, X, covariance = dense(around, noise, len(problem.columns))
    inverse = np.linalg.inv(covariance)
    assert found.square[0] == pytest.approx(residual @ inverse @ residual, rel=1e-6)
    assert np.allclose(found.slope[0], X.T @ inverse @ residual, rtol=1e-5, atol=1e-6 * np.abs(found.slope).max())
    assert np.allclose(found.gram[0], X.T @ inverse @ X, rtol=1e-5, atol=1e-8 * np.abs(found.gram).max())
    assert found.log_std[0] == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-6)


def test_the_smoother_gives_the_mean_of_the_dense_posterior():
    box, problem = box_of(swing(0.6, 3.0))
    (around,) = box.linearise(box.initial_point(problem.start_values()))
    noise = RunNoise(0.05, (1.0,), (ColouredNoise(),))
    sums = add_channels([around.whitened_sums(0, ColouredNoise())], noise.white_noise_ratios)[0]
    states, _ = smooth_run(sums, around.chain, noise.process_noise_std, np.zeros(len(problem.columns)))
    residual, _, covariance, of_states, mean = dense(around, noise, len(problem.columns), states=True)
    posterior = mean + of_states @ np.linalg.solve(covariance, residual)
    assert np.allclose(states.ravel(), posterior, rtol=1e-5, atol=1e-8)


def measured(variance, information):
    """Covariances (S, n, n) after a measurement by Kalman's filter, and the (S,) log-determinants."""
    n = variance.shape[-1]
    told = semidefinite_cholesky(information)[:, None]
    after, size, _ = kalman_covariances(variance, told, np.eye(n)[None], np.zeros_like(variance))
    return after[:, 0], size


def test_variances_after_a_measurement_are_those_of_the_dense_formula():
    rng = np.random.default_rng(3)
    factors, told = rng.normal(size=(2, 6, 4, 4))
    variance, information = (x @ np.swapaxes(x, 1, 2) for x in (factors, told * [3.0, 1.0, 0.1, 0.0]))
    after, size = measured(variance, information)
    assert np.allclose(after, np.linalg.inv(np.linalg.inv(variance) + information), rtol=1e-6, atol=1e-9)
    assert np.allclose(size, np.linalg.slogdet(np.eye(4) + variance @ information)[1], rtol=1e-9)


def test_states_that_were_not_known_at_all_are_known_to_all_digits_after_a_measurement():
    factors = np.random.default_rng(3).normal(size=(6, 4, 4))
    information = factors @ np.swapaxes(factors, 1, 2) + np.eye(4)
    after, _ = measured(np.broadcast_to(1e12 * np.eye(4), (6, 4, 4)), information)
    assert np.allclose(after, np.linalg.inv(information + 1e-12 * np.eye(4)), rtol=1e-9, atol=1e-9)


def test_what_a_divergence_tells_ends_in_no_singular_matrix():
    exploded = 1e39 * np.ones((4, 1)) @ np.ones((1, 4))
    after, size = measured(np.eye(4)[None], (exploded @ exploded.T)[None])
    assert np.isfinite(after).all()
    assert size == pytest.approx(np.log(16e78))
    assert np.isnan(measured(np.eye(4)[None], np.full((1, 4, 4), np.nan))[1])


def test_covariances_of_many_pieces_are_those_of_one_piece_after_the_other():
    rng = np.random.default_rng(3)
    pieces = PIECES_PER_BLOCK + 3
    told, transition = 0.3 * rng.normal(size=(2, pieces, 3, 3)), 0.3 * rng.normal(size=(pieces, 3, 3)) + np.eye(3)
    variance, kicks = np.stack([np.eye(3), 1e4 * np.eye(3)]), np.stack([1e-3 * np.eye(3), np.diag([0.0, 1.0, 0.0])])
    after, size, following = kalman_covariances(
        variance, semidefinite_cholesky(told @ np.swapaxes(told, 2, 3)), transition, kicks
    )
    total = np.zeros(2)
    for j in range(pieces):
        now, spread = measured(variance, told[:, j] @ np.swapaxes(told[:, j], 1, 2))
        assert np.allclose(after[:, j], now, rtol=1e-9, atol=1e-12)
        total, variance = total + spread, transition[j] @ now @ transition[j].T + kicks
    assert np.allclose(size, total, rtol=1e-9)
    assert np.allclose(following, variance, rtol=1e-9, atol=1e-12)


def test_a_motion_goes_on_where_a_piece_is_cut():
    box, problem = box_of(swing(0.6, 3.0))
    point = box.initial_point(problem.start_values())
    before = box.linearise(point)[0]
    assert box.runs[0].pieces.split_marked_pieces(np.arange(len(point.states[0])) == 1)
    after = box.linearise(point)[0]
    kept = np.arange(len(after.states)) != 2
    assert np.array_equal(after.states[kept], before.states)
    assert np.allclose(after.chain.gap[1], 0.0, atol=1e-9)
    assert np.isfinite(box.optimise(box.identifiable(point, problem.mask_of_unknowns(["length"])), point).evidence)


def dense(around, noise, unknowns, *, states=False):
    """Residual, columns and covariance of all rows, in units of the white noise, without any recursion."""
    chain, (rows,) = around.chain, around.rows
    J, n = chain.gap.shape
    prior, mean, columns = np.zeros((J * n, J * n)), np.zeros(J * n), np.zeros((J * n, unknowns))
    P, m, M = chain.start_variance, chain.start[:, -1], chain.start[:, :-1]
    for j in range(J):
        here = slice(j * n, (j + 1) * n)
        mean[here], columns[here], prior[here, here] = m, M, P
        onward = np.eye(n)
        for i in range(j + 1, J):
            onward = chain.transition[i - 1] @ onward
            there = slice(i * n, (i + 1) * n)
            prior[there, here], prior[here, there] = onward @ P, (onward @ P).T
        T = chain.transition[j]
        m, M = T @ m + chain.gap[j], T @ M + chain.end_state_by_unknowns[j]
        P = T @ P @ T.T + noise.process_noise_std**2 * chain.process_noise_covariance
    places = np.argwhere(rows.there)
    H = np.zeros((len(places), J * n))
    X, r, time = np.zeros((len(places), unknowns)), np.zeros(len(places)), np.zeros(len(places))
    for k, (i, j) in enumerate(places):
        H[k, j * n : (j + 1) * n] = rows.value[i, j, :n]
        X[k], r[k], time[k] = rows.value[i, j, n:-1], rows.value[i, j, -1], rows.time[j, i]
    together = places[:, 1][:, None] == places[:, 1][None]
    coloured = (
        noise.coloured_noise[0].variance_ratio
        * np.exp(-np.abs(np.subtract.outer(time, time)) / noise.coloured_noise[0].correlation_time)
        * together
    )
    white = np.diag([rows.white[i, j] for i, j in places])  # a row may be the mean of fewer samples than others
    covariance = H @ prior @ H.T + noise.white_noise_ratios[0] ** 2 * (white + coloured)
    found = r - H @ mean, X + H @ columns, covariance
    return (*found, prior @ H.T, mean) if states else found


@pytest.mark.parametrize("reach", [0.0, 0.05])
def test_an_angle_tells_nothing_of_a_mass_whatever_is_lacking(reach):
    """Kicks are of rates: a heavier load is kicked as far, and is as far after it."""
    box, problem = box_of(swing(0.8, 10.0, quadratic=0.05, reach=reach), effects=())
    (around,) = box.linearise(box.initial_point(problem.start_values()))
    found = around.innovations([RunNoise(0.3, (1.0,), (ColouredNoise(),))], np.array([0.3]))
    length, mass = (next(i for i, c in enumerate(problem.columns) if c.parameter.name == n) for n in ("length", "mass"))
    assert found.gram[0, mass, mass] < 1e-18 * found.gram[0, length, length]


@pytest.mark.parametrize(
    ("amplitude", "seconds", "hidden"),
    [
        (2.9, 20.0, {"viscous": 0.15}),
        (2.5, 15.0, {"coulomb": 0.5}),
        (0.9, 52.0, {"coulomb": 0.05, "quadratic": 0.0047}),
        (1.5, 40.0, {"viscous": 0.02, "quadratic": 0.02}),
    ],
)
def test_fits_of_the_truth_reach_the_noise(amplitude, seconds, hidden):
    """Started at the frictionless minimum these ended in wrong ones: 978 mrad where 0.25 is reachable."""
    names = {"viscous": "pivot_viscous_friction", "coulomb": "pivot_coulomb_friction", "quadratic": "quadratic_drag"}
    effects = [CATALOGUE[names[name]] for name in hidden]
    study = make_study(pendulum_model(0.35, 0.2), [swing(amplitude, seconds, **hidden)], [], effects)
    assert add(study, effects).path[-1].rmse["swing_angle"] < 1.05 * 1e-3


@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ({}, set()),
        ({"coulomb": 0.15}, {"pivot_coulomb_friction"}),
        pytest.param(
            {"coulomb": 0.1, "quadratic": 0.02}, {"pivot_coulomb_friction", "quadratic_drag"}, marks=pytest.mark.slow
        ),
    ],
)
def test_the_right_frictions_are_named_in_a_decay(hidden, named):
    found = diagnose(make_study(pendulum_model(0.35, 0.2), [swing(1.2, 30.0, seed=3, **hidden)], [], EFFECTS))
    assert {candidate.effect for candidate in found.search.last.effects} == named


def test_the_missing_acceleration_of_dry_friction_steps_where_the_swing_turns_round():
    dry = [CATALOGUE["pivot_coulomb_friction"]]
    found = diagnose(make_study(pendulum_model(0.35, 0.2), [swing(1.2, 30.0, coulomb=0.15, noise=2e-4)], [], dry))
    (curve,) = [curve for curve in found.missing_force if curve.against == "speed"]
    fast = np.abs(curve.x) > 1.0
    assert np.allclose(curve.as_given[fast], -0.15 * np.sign(curve.x[fast]), atol=0.05)
    assert np.abs(curve.repaired[fast]).max() < 0.05
    assert "dry friction" in found.remarks


def test_a_glitch_is_not_believed():
    run = swing(1.0, 20.0, quadratic=0.03)
    angle = run.channels["swing_angle"].value.copy()
    angle[500:503] += 0.05
    spoilt = Run("a.csv", {"swing_angle": Channel(run.channels["swing_angle"].time, angle, "rad")})
    box, problem = box_of(spoilt)
    free = np.array([c.parameter.name in ("length", "quadratic_drag.coefficient") for c in problem.columns])
    believed = box.optimise(free, box.initial_point(problem.start_values())).sample_weights[0][0] == 1.0
    assert not believed[500:503].any()
    assert believed.mean() > 0.97


def test_innovations_at_many_noises_are_those_at_each():
    box, problem = box_of(swing(0.6, 3.0))
    (around,) = box.linearise(box.initial_point(problem.start_values()))
    noises, kicks = (
        [RunNoise(1.0, (1.0,), (c,)) for c in (ColouredNoise(), ColouredNoise(4.0, 0.1))],
        np.array([1e-3, 0.1]),
    )
    together = around.innovations(noises, kicks)
    for c, noise in enumerate(noises):
        sums, logs, rows = add_channels([around.whitened_sums(0, noise.coloured_noise[0])], noise.white_noise_ratios)
        for k, kick in enumerate(kicks):
            alone = filter_run([(sums[None], np.array([logs]), rows)], around.chain, np.array([kick]))
            assert together.square[2 * c + k] == pytest.approx(alone.square[0], rel=1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("glitch", [0.0, 3.0])
def test_an_oscillation_ends_where_it_is_a_small_share_of_its_largest_amplitude(noise, glitch):
    time, period, decay = np.arange(0.0, 60.0, 0.01), 1.3, 4.0
    value = 0.2 + np.exp(-time / decay) * np.cos(2.0 * np.pi * time / period)
    value += noise * np.random.default_rng(0).normal(size=len(time))
    value[-500] += glitch
    end = rest_time(Channel(time, value, "rad/s"), period)
    assert 0.5 * decay * np.log(1.0 / REST_AMPLITUDE_SHARE) < end < decay * np.log(1.0 / REST_AMPLITUDE_SHARE) + period
    if noise <= 0.01:
        assert end > decay * np.log(1.0 / REST_AMPLITUDE_SHARE) - 1.5 * period


def test_what_goes_on_has_no_end():
    time = np.arange(0.0, 20.0, 0.02)
    swinging = Channel(time, np.exp(-time / 60.0) * np.sin(5.0 * time), "rad")
    assert rest_time(swinging, 2.0 * np.pi / 5.0) == time[-1]


@pytest.mark.slow
def test_a_friction_that_a_camera_s_small_errors_prefer_is_tied_with_the_true_one():
    """Of two dry frictions, whose torques differ by a tenth, evidence is sure of one as the camera bends the angle."""

    def bent(run):
        (seen,) = run.channels.values()
        value = seen.value + 0.003 + 0.004 * np.sin(8.0 * seen.value)
        return Run(run.name, {"swing_angle": Channel(seen.time, value, "rad")})

    runs = [
        swing(a, 10.0, coulomb=0.08, noise=5e-4, rate=50.0, seed=k, name=f"{k}.csv") for k, a in ((0, 0.5), (3, 0.4))
    ]
    train, held_out = (bent(run) for run in runs)
    found = diagnose(make_study(pendulum_model(0.38, 0.2), [train], [held_out], EFFECTS))
    leading = found.ranked_effects[0]
    assert {leading.effect, *leading.tied_with} == {"pivot_coulomb_friction", "pivot_load_friction"}


def test_the_cost_with_one_more_effect_is_foretold_from_whole_runs_without_a_fit():
    """Truth has viscous and dry friction; the fit of the pair costs what the fit of one of them foretells."""
    run = swing(0.5, 20.0, viscous=0.05, coulomb=0.01)
    pair = [CATALOGUE[name] for name in ("pivot_viscous_friction", "pivot_coulomb_friction")]
    study = make_study(pendulum_model(LENGTH, 0.1), [run], [], [*pair, CATALOGUE["angle_offset"]])
    viscous, dry, offset = (next(c for c in study.candidates if c.effect == n) for n in
                            ("pivot_viscous_friction", "pivot_coulomb_friction", "angle_offset"))  # fmt: skip
    alone = study.quick_fit((viscous,))
    foretold = study.foretold_costs((viscous,), [dry, offset])
    for one in (dry, offset):
        fitted = study.fit_base_with_effects((viscous, one)).cost
        assert foretold[one] == pytest.approx(fitted, rel=0.01)
    assert foretold[dry] < alone.cost - 200.0 < foretold[offset] - 190.0
