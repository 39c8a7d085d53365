"""An unstable process is predicted in pieces: against closed forms, and derivatives against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.physics import Equations, Moment, constant, physics, state
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


def test_a_piece_begins_at_the_state_that_fits_it_and_follows_the_parameters():
    model = replace(physics_model(growing), restart=0.5)
    run = model.prepare_run(held(6.0))
    found = model.predict(run, model.theta())
    assert np.std(found.values - np.sin(found.time)) < NOISE
    step = 1e-4
    wrong = [model.predict(run, model.theta() + sign * step * np.eye(2)[0]).values for sign in (1.0, -1.0)]
    slopes = (wrong[0] - wrong[1]) / (2.0 * step)
    assert found.sensitivities[:, 0] == pytest.approx(slopes, abs=2e-2 * np.abs(slopes).max())
    assert not found.sensitivities[:, 1].any()  # a whole run's start plays no part
