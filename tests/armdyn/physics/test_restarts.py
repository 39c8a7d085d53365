"""An unstable process is predicted in pieces: against closed forms, and derivatives against finite differences."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.physics import Equations, Moment, constant, physics, state
from armdyn.physics.following import Following
from armdyn.physics.model import physics_model
from armdyn.physics.restarts import MAX_GROWTH, error_growth_rate, restart_seconds
from armdyn.run import Channel, Run

RATE, NOISE = 3.0, 1e-4


@physics(
    "growing", summary="x' = rate x + u", source="Malthus 1798", parameters=(constant("rate", "1/s", RATE),),
    states=(state("x", "m", typical=1.0),), inputs={"extra.u": "m/s"}, outputs={"extra.x": "m"}, period=0.5,
)  # fmt: skip
def growing(at: Moment) -> Equations:
    return Equations({"x": at["rate"] * at["x"] + at.input("extra.u").value}, {"extra.x": at["x"]})


def held(seconds, rate=RATE):
    """A controller holds x = sin t by u = cos t - rate sin t; measured with noise."""
    time = np.arange(0.0, seconds, 0.01)
    x = np.sin(time) + NOISE * np.random.default_rng(0).standard_normal(len(time))
    channels = {"extra.u": Channel(time, np.cos(time) - rate * np.sin(time), "m/s"), "extra.x": Channel(time, x, "m")}
    return Run("a.csv", channels)


def test_the_growth_of_errors_is_the_rate_of_the_linear_process():
    model = physics_model(growing)
    run = model.prepare_run(held(10.0))
    assert error_growth_rate(model, run, model.theta()) == pytest.approx(RATE, rel=0.01)
    assert restart_seconds(model, [run], {("a.csv", "extra.x"): NOISE}) == pytest.approx(
        np.log(MAX_GROWTH) / RATE, rel=0.01
    )


def test_a_run_in_which_errors_stay_below_the_motion_is_predicted_as_a_whole():
    model = physics_model(growing)
    assert restart_seconds(model, [model.prepare_run(held(1.0))], {("a.csv", "extra.x"): NOISE}) is None
    fading = physics_model(growing).with_values({"rate": -RATE})
    run = fading.prepare_run(held(10.0, -RATE))
    assert error_growth_rate(fading, run, fading.theta()) == pytest.approx(-RATE, rel=0.01)
    assert restart_seconds(fading, [run], {("a.csv", "extra.x"): NOISE}) is None


def test_what_one_recording_needs_is_forgotten_with_another():
    noise = {("a.csv", "extra.x"): NOISE}
    model = physics_model(growing)
    long, short = (model.prepare_run(held(seconds)) for seconds in (10.0, 1.0))
    unstable = model.suited_to([long], noise)
    assert unstable.following.restart is not None
    assert unstable.suited_to([short], noise).following.restart is None


def test_a_piece_begins_at_the_state_that_fits_it_and_follows_the_parameters():
    model = replace(physics_model(growing), following=Following(restart=0.5))
    run = model.prepare_run(held(6.0))
    found = model.predict(run, model.theta())
    assert np.std(found.values - np.sin(found.time)) < NOISE
    step = 1e-4
    wrong = [model.predict(run, model.theta() + sign * step * np.eye(2)[0]).values for sign in (1.0, -1.0)]
    slopes = (wrong[0] - wrong[1]) / (2.0 * step)
    assert found.sensitivities[:, 0] == pytest.approx(slopes, abs=2e-2 * np.abs(slopes).max())
    assert not found.sensitivities[:, 1].any()  # a whole run's start plays no part


@physics(
    "dropped", summary="a ball on a stiff floor", source="Hertz 1881", parameters=(constant("floor", "1/s^2", 2e4),),
    states=(state("x", "m", typical=0.1, start=0.05), state("v", "m/s", typical=1.0)), inputs={},
    outputs={"extra.x": "m"}, period=0.5, step=0.01,
)  # fmt: skip
def dropped(at: Moment) -> Equations:
    return Equations({"x": at["v"], "v": at["floor"] * ca.fmax(-at["x"], 0) - 9.81}, {"extra.x": at["x"]})


def test_steps_are_halved_where_a_contact_falls_into_them_and_not_where_the_noise_hides_it():
    model = physics_model(dropped)
    time = np.arange(0.0, 1.0, 0.01)
    truth = solve_ivp(
        lambda _, s: [s[1], 2e4 * max(-s[0], 0.0) - 9.81], (0.0, 1.0), [0.05, 0.0], t_eval=time, rtol=1e-10, atol=1e-12,
        max_step=1e-3,
    ).y[0]  # fmt: skip
    run = model.prepare_run(Run("a.csv", {"extra.x": Channel(time, truth, "m")}))
    fine, coarse = (model.refined_for([run], {("a.csv", "extra.x"): noise}, [model.theta()]) for noise in (1e-5, 1.0))
    assert coarse.following.refinement == 1
    assert fine.following.refinement > 1
    far, near = (np.std(each.predict(run, each.theta()).values - truth) for each in (coarse, fine))
    assert near < 0.2 * far
