"""The generator's own physics, and the fit that says what the truth reaches."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import dry_swing, pendulum
from worlds.dry_swing import G, Pendulum, Push, swing
from worlds.imperfect_pendulum import VISIBLE, world
from worlds.output_error import fitted, predicted

STILL = Push()


def test_a_finer_step_moves_the_angle_by_less_than_any_sensor_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    dry = Pendulum(0.3, 0.1, {"pivot_coulomb_friction": 1e-3, "quadratic_drag": 1e-2})
    time = np.arange(0.0, 60.0, 0.01)
    for start in (1.2, 2.95):
        angle = swing(dry, (start, 0.0), STILL, time).angle
        with monkeypatch.context() as finer:
            finer.setattr(dry_swing, "STEPS", 1000)
            finer.setattr(dry_swing, "STEEP_STEPS", 2000)
            assert swing(dry, (start, 0.0), STILL, time).angle == pytest.approx(angle, abs=3e-6)


def test_coulomb_friction_takes_the_same_angle_from_every_period_and_then_holds() -> None:
    torque, mass, length = 2e-3, 0.1, 0.5
    dry = Pendulum(length, mass, {"pivot_coulomb_friction": torque})
    time = np.arange(0.0, 40.0, 0.001)
    angle = swing(dry, (0.05, 0.0), STILL, time).angle
    peaks = angle[1:-1][(angle[1:-1] > angle[:-2]) & (angle[1:-1] >= angle[2:])]
    assert np.diff(peaks[:2]) == pytest.approx(-4 * torque / (mass * G * length), rel=2e-3)
    assert np.ptp(angle[-10_000:]) == 0.0
    assert abs(mass * G * length * np.sin(angle[-1])) <= torque


def test_load_friction_is_coulomb_friction_where_the_tension_is_the_weight() -> None:
    time, mass, length = np.arange(0.0, 10.0, 0.01), 0.2, 0.4
    arm = 1e-3
    by_load = swing(Pendulum(length, mass, {"pivot_load_friction": arm}), (0.03, 0.0), STILL, time)
    constant = swing(Pendulum(length, mass, {"pivot_coulomb_friction": arm * mass * G}), (0.03, 0.0), STILL, time)
    assert by_load.angle == pytest.approx(constant.angle, abs=2e-5)


def test_a_load_at_rest_is_not_moved_by_a_gripper_that_pulls_less_than_friction() -> None:
    dry = Pendulum(0.4, 0.1, {"pivot_coulomb_friction": 5e-3})
    assert np.all(swing(dry, (0.0, 0.0), Push(_sine(0.002)), np.arange(0.0, 5.0, 0.01)).angle == 0.0)
    assert np.ptp(swing(dry, (0.0, 0.0), Push(_sine(0.02)), np.arange(0.0, 5.0, 0.01)).angle) > 0.01


@pytest.mark.parametrize(
    ("hidden", "error"),
    [
        ({"pivot_viscous_friction": 2e-3, "quadratic_drag": 1e-2, "wind": 0.01}, 1e-6),
        ({"gripper_lag": 0.03, "gripper_scale": 0.05}, 1e-4),
    ],
)
def test_a_driven_swing_is_that_of_the_particle_in_space(hidden: dict[str, float], error: float) -> None:
    motion = pendulum.gripper_motion(np.random.default_rng(3))
    time = np.arange(0.0, 8.0, 0.01)
    truth = pendulum.in_space(pendulum.Setup(hidden=hidden, duration=8.0, start=(0.2, 0.1)), motion, time)
    found = swing(Pendulum(0.368, 0.08, hidden), (0.2, 0.1), Push(motion), time)
    assert found.angle == pytest.approx(truth["angle"], abs=error)
    if "gripper_lag" not in hidden:
        assert found.tension == pytest.approx(truth["tension"], abs=1e-5)


@pytest.mark.slow
def test_the_truth_reaches_the_noise_and_half_the_truth_does_not() -> None:
    clear = world(2, "fits")
    records, (noise,) = clear.records["run"], clear.noise.values()
    whole = fitted(clear.pendulum, tuple(clear.hidden), records)
    assert np.sqrt(np.mean(np.square(whole.rmse))) == pytest.approx(noise, rel=0.05)
    assert whole.pendulum.length == pytest.approx(clear.length, rel=1e-3)
    bare = fitted(replace(clear.pendulum, effects={}), (), records)
    assert min(bare.rmse) > VISIBLE * noise
    assert predicted(whole.pendulum, clear.records["exam"]).rmse[0] == pytest.approx(noise, rel=0.1)


def _sine(size: float):
    def motion(t: np.ndarray) -> np.ndarray:
        w = 3.0
        return size * np.array([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])

    return motion
