from functools import partial

import numpy as np
import pytest
from derivatives import assert_jacobian
from worlds import baxter as hidden_arm

from armdyn.errors import InputError
from armdyn.experiments.columns import TorqueRegressor, random_joint_states, with_all_parameters_active
from armdyn.experiments.criteria import RivalSeparation, d_optimality, log_condition, log_harmonic_separation
from armdyn.experiments.series import JOINT_MAX_PERIOD_SECONDS, FourierSeries


def extended(model, effects):
    for effect in effects:
        model = model.with_effect(effect)
    return TorqueRegressor(with_all_parameters_active(model), 100.0)


@pytest.fixture
def states(baxter):
    return random_joint_states(baxter.arm, 20)


def test_a_payloads_column_is_the_torque_that_mujoco_finds_for_it(baxter, effects, states):
    columns = extended(baxter, effects("payload"))
    place = {f"payload.{axis}[right_w2]": p for axis, p in zip("xyz", hidden_arm.PAYLOAD_PLACE, strict=True)}
    columns = TorqueRegressor(columns.model.with_values(place), 100.0)
    torque = columns.values_along(states)[:, :, columns.column_indices("payload")[0]] * columns.noise
    motion = states.q, states.v, states.a
    expected = hidden_arm.rigid_torque(*motion, payload=1.3) - hidden_arm.rigid_torque(*motion, payload=0.3)
    assert torque == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_a_links_mass_column_is_what_mujoco_finds_for_a_heavier_link(baxter, effects, states):
    columns = extended(baxter, effects("link_inertia"))
    index = columns.model.names.index("link_inertia.mass[right_e0]")
    torque = columns.values_along(states)[:, :, index] * columns.noise / columns.typical[index]
    motion, step = (states.q, states.v, states.a), 1e-4
    heavier = np.zeros(7)
    heavier[2] = step
    difference = hidden_arm.rigid_torque(*motion, heavier=heavier) - hidden_arm.rigid_torque(*motion, heavier=-heavier)
    expected = difference / (2 * step)
    assert torque == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_torques_are_mujocos_with_the_damping_of_the_urdf(baxter, states):
    torque = TorqueRegressor(baxter, 100.0).described_torque(states)
    expected = hidden_arm.rigid_torque(states.q, states.v, states.a)
    expected = expected + np.asarray(baxter.arm.model.damping) * states.v
    assert torque == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_slopes_are_those_of_finite_differences(shoulder, effects):
    columns = extended(shoulder, effects("joint_coulomb_friction link_inertia gravity_spring joint_load_friction"))
    states, rng = random_joint_states(shoulder.arm, 6), np.random.default_rng(1)
    by_columns = rng.standard_normal((6, 3, len(columns.unknowns)))
    by_torque = rng.standard_normal((6, 3))

    def total(moved):
        return float(
            np.sum(columns.values_along(moved) * by_columns) + np.sum(columns.described_torque(moved) * by_torque)
        )

    for name, gradient in zip("qva", columns.with_gradient(states)[2](by_columns, by_torque), strict=True):
        direction, h = rng.standard_normal(states.q.shape), 1e-5
        ends = [total(states._replace(**{name: getattr(states, name) + sign * h * direction})) for sign in (1, -1)]
        measured = (ends[0] - ends[1]) / (2 * h)
        assert measured == pytest.approx(float(np.sum(gradient * direction)), rel=1e-3)


def test_an_effect_that_acts_through_its_mass_has_one(baxter, effects):
    columns = extended(baxter, effects("payload"))
    assert columns.model.value("payload.mass[right_w2]") == 1.0
    assert np.all(np.any(columns.values_along(random_joint_states(baxter.arm, 20)) != 0.0, axis=(0, 1)))


def test_a_delay_is_refused_in_one_line(shoulder, effects, complains):
    with complains(InputError):
        extended(shoulder, effects("torque_delay")).values_along(random_joint_states(shoulder.arm, 2))


def coefficients(series):
    return np.random.default_rng(3).standard_normal((2, series.coefficient_count))


@pytest.mark.parametrize("seconds", [2.0, 7.3, 20.0, 50.0])
def test_a_motion_starts_and_ends_at_rest_with_zero_acceleration(seconds):
    series = FourierSeries(seconds)
    ends = series.basis_at(np.array([0.0, seconds])).motion(coefficients(series))
    inside = series.basis_at(np.linspace(0.0, seconds, 200)).motion(coefficients(series))
    assert np.abs(ends.v).max() < 1e-9 * np.abs(inside.v).max()
    assert np.abs(ends.a).max() < 1e-9 * np.abs(inside.a).max()
    assert ends.q[0] == pytest.approx(ends.q[1])


def test_velocity_and_acceleration_are_the_derivatives_of_position():
    series = FourierSeries(20.0)
    time, h = np.linspace(0.5, 19.0, 60), 1e-4
    x = coefficients(series)
    before, here, after = (series.basis_at(time + k * h).motion(x) for k in (-1, 0, 1))
    assert here.v == pytest.approx((after.q - before.q) / (2 * h), abs=1e-5)
    assert here.a == pytest.approx((after.v - before.v) / (2 * h), abs=1e-4)


def test_a_long_motion_repeats_a_period():
    series = FourierSeries(50.0)
    assert series.period <= JOINT_MAX_PERIOD_SECONDS
    time = np.linspace(0.0, 5.0, 20)
    x = coefficients(series)
    assert series.basis_at(time + series.period).motion(x).q == pytest.approx(series.basis_at(time).motion(x).q)


def test_few_harmonics_hold_no_higher_frequency():
    series = FourierSeries(20.0)
    x = coefficients(series) @ series.low_harmonics_projection(5)
    samples = series.basis_at(series.period * np.arange(256) / 256).motion(x).q
    power = np.abs(np.fft.rfft(samples, axis=0)) ** 2
    assert power[6:].max() < 1e-18 * power.max()
    ends = series.basis_at(np.zeros(1)).motion(x)
    assert np.abs([ends.v, ends.a]).max() < 1e-9


P = 7
ROWS = np.random.default_rng(0).standard_normal((30, P)) * np.linspace(1.0, 4.0, P)
INFORMATION = ROWS.T @ ROWS
PRIOR = np.array([10.0, 10.0, 2.0, np.inf, 10.0, 1.0, 10.0])
HIDDEN = (
    RivalSeparation("a", "j", "b", np.array([0, 1]), np.array([2, 3, 6]), np.eye(2)),
    RivalSeparation("b", "j", "a", np.array([2, 3]), np.array([0, 1, 6]), np.array([[0.6], [0.8]])),
)
CRITERIA = {
    "determined": partial(d_optimality, prior=PRIOR, wanted=np.array([0, 3, 5])),
    "separated": partial(log_harmonic_separation, prior=PRIOR, cases=HIDDEN),
    "conditioned": partial(log_condition, typical=np.linspace(0.5, 2.0, P), independent=np.array([0, 1, 3, 4])),
}


@pytest.mark.parametrize("name", CRITERIA)
def test_derivatives_are_exact(name):
    criterion = CRITERIA[name]
    _, slopes = criterion(INFORMATION)
    assert slopes == pytest.approx(slopes.T)

    def of_rows(flat):
        X = flat.reshape(ROWS.shape)
        return np.array([criterion(X.T @ X)[0]])

    assert_jacobian(of_rows, ROWS.ravel(), (2.0 * ROWS @ slopes).ravel()[None], 1e-3, 1e-5)


def test_determined_is_the_mean_logarithm_of_the_standard_deviations_of_a_fit():
    """Of one unknown alone: that of the least-squares problem with the priors as further rows."""
    wanted, prior = 4, np.full(P, 3.0)
    whole = np.vstack([ROWS, np.diag(1.0 / prior)])
    variance = np.linalg.inv(whole.T @ whole)[wanted, wanted]
    value, _ = d_optimality(INFORMATION, prior, np.array([wanted]))
    assert value == pytest.approx(0.5 * np.log(variance))


def test_a_separation_is_what_a_refit_of_the_rival_leaves():
    """Brute force: the hidden change as data, the rival and the nuisance fitted to it with their priors."""
    case = HIDDEN[0]
    left, _ = case.information_after_refit(INFORMATION, PRIOR)
    for change in (np.array([1.0, 0.0]), np.array([-0.3, 2.0])):
        X = np.vstack([ROWS[:, case.fitted], np.diag(1.0 / PRIOR[case.fitted])])
        data = np.concatenate([ROWS[:, case.own] @ change, np.zeros(len(case.fitted))])
        refit, *_ = np.linalg.lstsq(X, data, rcond=None)
        assert float(np.sum((data - X @ refit) ** 2)) == pytest.approx(change @ left @ change)
    angles = np.linspace(0.0, np.pi, 400)
    smallest = min(d @ left @ d for d in np.column_stack([np.cos(angles), np.sin(angles)]))
    assert case.separation(INFORMATION, PRIOR) == pytest.approx(smallest, rel=1e-3)


def test_conditioned_is_the_condition_number_of_the_regression():
    independent, typical = np.array([0, 1, 3, 4]), np.linspace(0.5, 2.0, P)
    X = ROWS[:, independent] / typical[independent]
    assert log_condition(INFORMATION, typical, independent)[0] == pytest.approx(np.log(np.linalg.cond(X)))
