"""A sensor that is late is told wherever another clock shows it, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from worlds import pendulum

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.identify.compare import compare
from armdyn.identify.repair import add
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

LATE, NOISE = 0.015, {"load_force": 3e-3, "swing_angle": 1e-3, "swing_rate": 5e-3}
UNITS = {"load_force": "N", "swing_angle": "rad", "swing_rate": "rad/s"}
OWN = {"load_force": "time", "swing_angle": "angle_time", "swing_rate": "rate_time"}
TIME = np.arange(0.0, 12.0, 0.01)
DELAY = CATALOGUE["sensor_delay"]


def recorded(true, late, begin=0.0):
    """A run of what is (n,) true at `TIME`, by channel; one of them is read late."""
    rng, channels = np.random.default_rng(3), {}
    kept = begin <= TIME
    for name, value in true.items():
        read = CubicSpline(TIME, value)(TIME - LATE * (name == late))[kept]
        noisy = read + NOISE[name] * rng.normal(size=len(read))
        channels[name] = Channel(TIME[kept], noisy, UNITS[name])
    return Run("a.csv", channels, {}, {name: NOISE[name] for name in true})


def driven(late):
    """Angle and force below a moving gripper."""
    motion = pendulum.gripper_motion(np.random.default_rng(1))
    truth = pendulum.simulate(pendulum.Setup(duration=TIME[-1]), motion, TIME)
    run = recorded({"swing_angle": truth["angle"], "load_force": truth["tension"]}, late)
    channels = {**run.channels, "gripper_x": Channel(TIME, motion(TIME)[0], "m")}
    return replace(run, channels=channels, noise={**run.noise, "gripper_x": 0.0})


def free(late, *names):
    """A swing below a fixed pivot, in motion when the recording begins."""
    states = solve_ivp(
        lambda _, s: [s[1], -9.81 / 0.368 * np.sin(s[0]) - 0.03 * s[1]], (0.0, TIME[-1]), [0.6, 0.0], "DOP853", TIME
    ).y
    true = {"swing_angle": states[0], "swing_rate": states[1]}
    return recorded({name: true[name] for name in names}, late, 0.1)


def study_of(run, *effects):
    return make_study(pendulum_model(0.35, 0.1, effects), [run], [], [DELAY, CATALOGUE["sensor_lag"]])


@pytest.mark.parametrize("late", ["swing_angle", "load_force"])
def test_the_delay_of_each_sensor_is_found_against_the_gripper(late):
    found = add(study_of(driven(late)), [DELAY]).model.parameters
    for name in ("swing_angle", "load_force"):
        delay = found[f"sensor_delay.{OWN[name]}"]
        assert delay.value == pytest.approx(LATE if name == late else 0.0, abs=3e-4)


def test_a_gyro_is_late_against_the_angle_of_a_free_swing():
    friction = CATALOGUE["pivot_viscous_friction"]
    found = add(study_of(free("swing_rate", "swing_angle", "swing_rate"), friction), [DELAY]).model
    difference = found.value("sensor_delay.rate_time") - found.value("sensor_delay.angle_time")
    assert difference == pytest.approx(LATE, abs=3e-4)


def test_a_free_swing_alone_shows_no_delay_and_says_what_would(complains):
    study = study_of(free("swing_angle", "swing_angle"))
    assert not study.candidates
    with complains(InputError):
        add(study, [DELAY])


def test_a_delay_that_a_recording_cannot_show_keeps_its_value():
    run = free("swing_angle", "swing_angle")
    model = pendulum_model(0.35, 0.1, [DELAY]).with_values({"sensor_delay.angle_time": LATE})
    found = compare(make_study(model, [run], [], [])).parameters["sensor_delay.angle_time"]
    assert (found.value, found.fitted) == (LATE, False)
