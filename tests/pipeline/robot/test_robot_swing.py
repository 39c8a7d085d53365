import numpy as np
import pytest
from simulated_truth import load_truth

from pipeline.robot.settings import CellSettings, PlantSettings


def wandering(time):
    """A motion like those of active estimation: 0.09 m, 0.24 m/s, 1.1 m/s^2, from rest."""
    waves = ((0.05, 2.9), (0.012, 7.3), (-0.03, 1.3))
    x = sum(a * np.sin(w * time) for a, w in waves)
    v = sum(a * w * np.cos(w * time) for a, w in waves)
    u = sum(-a * w * w * np.sin(w * time) for a, w in waves)
    b = min(time, 1.0)
    k, dk, ddk = b**3 * (10 - 15 * b + 6 * b * b), 30 * b**2 * (1 - b) ** 2, 60 * b * (1 - b) * (1 - 2 * b)
    return k * x, k * v + dk * x, k * u + 2 * dk * v + ddk * x


def test_tension_equals_the_pendulum_formula_while_the_arm_moves(plant, follow):
    robot = plant(settings=PlantSettings(), seed=5)
    rows = follow(robot, wandering, 6.0)
    angle = np.array([load.swing_angle for *_, load in rows])
    rate = np.array([load.swing_rate for *_, load in rows])
    along = np.array([gripper.s_acceleration for _, _, gripper, _ in rows])
    up = np.array([gripper.acceleration[2] for _, _, gripper, _ in rows])
    tension = np.array([load.tension for *_, load in rows])
    expected = robot.truth.mass * ((9.81 + up) * np.cos(angle) + 0.368 * rate**2 + along * np.sin(angle))
    assert np.abs(angle).max() > 0.2
    assert np.std(tension - expected) < 1.5e-3


def test_tension_of_a_free_swing_equals_the_pendulum_formula(still_pendulum):
    plant = still_pendulum(0.5)
    for _ in range(300):
        plant.advance(0.01)
        load = load_truth(plant)
        expected = 0.08 * (9.81 * np.cos(load.swing_angle) + 0.368 * load.swing_rate**2)
        assert load.tension == pytest.approx(expected, abs=3e-3)


def test_at_rest_the_load_hangs_at_the_given_length_and_the_tension_equals_its_weight(plant, baxter):
    robot = plant(settings=PlantSettings(length=0.4), seed=2)
    before = load_truth(robot)
    robot.advance(1.0)
    after = load_truth(robot)
    assert before.tension == pytest.approx(9.81 * robot.truth.mass, abs=1e-9)
    assert after.tension == pytest.approx(9.81 * robot.truth.mass, abs=1e-9)
    np.testing.assert_allclose(before.position, baxter.line.position(0.0) - [0, 0, 0.4], atol=1e-9)
    np.testing.assert_allclose(after.position, before.position, atol=1e-9)


def test_string_loses_less_than_a_hundredth_of_the_swing_energy_in_15_seconds(still_pendulum, watch):
    swing = watch(still_pendulum(0.4), 15.0)
    height = swing.distance * -np.cos(swing.angle)
    first, last = height[:200].max(), height[-200:].max()
    assert 0.0 <= (first - last) / (first + 0.368) < 0.01


def test_string_goes_slack_and_never_pushes(still_pendulum, watch):
    plant = still_pendulum(1.5)
    swing = watch(plant, 3.0)
    assert swing.tension.min() >= 0.0
    falling = still_pendulum(0.0)
    # Thrown up inside the string's reach the load falls freely until the string is taut again.
    data = falling._data
    data.qvel[9] = 1.5
    swing = watch(falling, 0.25)
    free = slice(2, None)
    assert (swing.tension[free] == 0.0).all()
    height = -swing.distance
    expected = -0.368 + 1.5 * swing.time - 0.5 * 9.81 * swing.time**2
    np.testing.assert_allclose(height[free], expected[free], atol=2e-3)


def test_same_seed_gives_the_same_motion_and_readings_also_where_the_truth_is_looked_at(plant, table, follow):
    def run(seed, watched=False):
        robot = plant({"quadratic_drag": None}, seed, PlantSettings())
        if watched:
            follow(robot, wandering, 0.5)
        else:
            for _ in range(50):
                motion = table.joint_motion(*wandering(robot.time))
                robot.command(motion.q, motion.v, motion.a)
                robot.advance(0.01)
        joints, force = robot.joint_state(), [s.force for s in robot.load_cell()]
        return np.concatenate([joints.q, joints.v, joints.tau, force[:40], robot.history().load.ravel()])

    once = run(4)
    np.testing.assert_array_equal(run(4, watched=True), once)
    assert np.mean(run(5) == once) < 0.2


def test_what_is_drawn_stays_within_its_spread_and_what_is_given_is_not_drawn(plant):
    truths = [plant(settings=PlantSettings(), seed=s).truth for s in range(40)]
    latency = np.array([t.latency for t in truths])
    assert 0.0 <= latency.min() < 0.005
    assert 0.015 < latency.max() <= 0.02
    assert np.abs(np.array([t.link_scale for t in truths]) - 1.0).max() <= 0.1
    assert 0.004 < np.std([t.mass / 0.08 for t in truths]) < 0.02
    truth = plant(settings=PlantSettings(), cell=CellSettings(latency=0.007, bias=-0.02), seed=9).truth
    assert (truth.latency, truth.bias) == (0.007, -0.02)
