"""The fastest feasible speed along a path: against closed forms, an independent optimum, and the check."""

import json

import numpy as np
import pytest
import ruckig
from command import called
from scipy.optimize import linprog

from armdyn.errors import TaskFailedError
from pipeline.motion.averaged import RetimingLimits
from pipeline.motion.fastest_speed import fastest_speed
from pipeline.motion.feasibility import CheckSettings, check_joints
from pipeline.motion.feasibility.read import read_trajectory
from pipeline.motion.path_nodes import RETIMED_LIMIT_SHARE
from pipeline.motion.retime import retimed, retimed_on_arm
from pipeline.motion.trajectory import AT_REST, EndVelocities
from urdf import load
from urdf.robot import Limits

ALONG = np.linspace(0.0, 1.0, 101)


def limits(velocity=2.0, acceleration=5.0, jerk=50.0):
    one = np.ones(1)
    return Limits(-4 * one, 4 * one, velocity * one, acceleration * one, jerk * one, 10 * one)


def weightless(q, v, a):
    """Torque 2 a + 3 v + 1 sign(v), without band."""
    return 2.0 * a + 3.0 * v + np.sign(v), np.zeros_like(q)


def test_a_double_integrator_accelerates_half_of_the_way_and_brakes_on_the_other():
    rows = np.tile([1.0, -1.0], (101, 1)), np.zeros((101, 2)), np.full((101, 2), 4.0)
    found = fastest_speed(ALONG, rows, np.full(101, np.inf))
    assert found.x == pytest.approx(8.0 * np.minimum(ALONG, 1.0 - ALONG))
    capped = fastest_speed(ALONG, rows, np.full(101, 1.0))
    assert capped.x == pytest.approx(np.minimum(8.0 * np.minimum(ALONG, 1.0 - ALONG), 1.0))


@pytest.mark.parametrize("seed", range(3))
def test_the_squared_speeds_are_the_largest_that_a_linear_program_finds(seed):
    """All squared speeds are the largest at once: their sum is, too."""
    rng, n, m = np.random.default_rng(seed), 21, 6
    s = np.linspace(0.0, 1.0, n)
    waves = [np.cumsum(rng.normal(0.0, 0.3, (n, m)), axis=0) / 3.0 for _ in range(2)]
    a, b = waves[0] + rng.choice([-1.0, 1.0], m), waves[1]
    rows = np.hstack([a, -a]), np.hstack([b, -b]), np.full((n, 2 * m), 3.0)
    found, step = fastest_speed(s, rows, np.full(n, 9.0)), s[1] - s[0]
    A, c = [], []
    for i in range(n - 1):
        for at in (i, i + 1):
            for k in range(2 * m):
                row = np.zeros(n)
                row[i + 1] += rows[0][at, k] / (2 * step)
                row[i] -= rows[0][at, k] / (2 * step)
                row[at] += rows[1][at, k]
                A.append(row)
                c.append(3.0)
    bounds = [(0.0, 0.0 if i in (0, n - 1) else 9.0) for i in range(n)]
    best = linprog(-np.ones(n), np.array(A), np.array(c), bounds=bounds)
    assert found.x.sum() == pytest.approx(-best.fun, rel=1e-6)


@pytest.mark.parametrize("band", [0.0, 0.2])
def test_friction_and_damping_are_overcome_on_the_way_there(band):
    """From q = 0 to 2 with at most 8 N m, of which 99 % are used: analytic bang-bang of 2 a + 3 v + 1 = +-7.92.

    A band of 20 % leaves so much less; at the largest speed it alone is more than the limit. The bands of both signs
    are those at constant speed, so that braking against the damping uses a little less than it could.
    """
    given = RetimingLimits(limits(velocity=50.0), np.array([8.0]), jerk=False)

    def uncertain(q, v, a):
        torque, _ = weightless(q, v, a)
        return torque, band * np.abs(torque)

    found = retimed(np.linspace(0.0, 2.0, 50)[:, None], ("q",), given, uncertain)
    time, most = np.linspace(0.0, 3.0, 300001), RETIMED_LIMIT_SHARE * 8.0 / (1.0 + band)
    forth = (most - 1.0) / 3.0 * (1.0 - np.exp(-1.5 * time))
    way = np.concatenate([[0.0], np.cumsum(forth[:-1] * np.diff(time))])
    braking = 2.0 / 3.0 * np.log1p(3.0 * forth / (most + 1.0))  # from v to rest with 2 a = -(8.92 + 3 v)
    further = forth * 2.0 / 3.0 - (most + 1.0) / 3.0 * braking
    end = int(np.argmax(way + further >= 2.0))
    assert found.time[-1] == pytest.approx(time[end] + braking[end], rel=0.05 if band else 0.02)
    assert np.add(*map(np.abs, uncertain(found.q, found.v, found.a))).max() <= 8.0


def test_a_jerk_limit_gives_the_time_of_a_double_s_within_a_tenth():
    """Of 2 rad with 2 rad/s, 5 rad/s^2 and 50 rad/s^3 (Biagiotti & Melchiorri 2008, eq. 3.37)."""
    given = RetimingLimits(limits(), np.array([np.inf]))
    found = retimed(np.linspace(0.0, 2.0, 50)[:, None], ("q",), given, lambda q, v, a: (0 * v + 0 * a, 0 * q))
    fastest = 2.0 / 2.0 + 2.0 / 5.0 + 5.0 / 50.0
    assert fastest < found.time[-1] < 1.1 * fastest
    assert found.q[[0, -1], 0] == pytest.approx([0.0, 2.0], abs=1e-12)
    assert np.abs(found.v[[0, -1]]).max() < 1e-9


@pytest.mark.parametrize("length", [0.001, 0.002])
def test_a_small_bend_at_the_start_does_not_slow_the_whole_motion(length):
    """3 rad with 2 rad/s, 20 rad/s^2 and 1000 rad/s^3 take 3 / 2 + 2 / 20 + 20 / 1000 s without the bend."""
    two, x = np.ones(2), 3.0 * np.linspace(0.0, 1.0, 400) ** 3
    points = np.c_[x, 2.0 * length * np.sin(np.pi * np.minimum(x / length, 1.0)) ** 3]
    given = RetimingLimits(Limits(-4 * two, 4 * two, 2 * two, 20 * two, 1000 * two, 10 * two), np.inf * two)
    found = retimed(points, ("q", "r"), given, lambda q, v, a: (0 * v + 0 * a, 0 * q))
    assert found.time[-1] < 1.12 * (3.0 / 2.0 + 2.0 / 20.0 + 20.0 / 1000.0)
    assert np.abs(np.diff(found.a, axis=0)).max() / np.diff(found.time).min() <= 1000.0 * 1.0001


def inertia(q, v, a):
    """Torque 2 a."""
    return 2.0 * a + 0.0 * v, np.zeros_like(q)


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.5), (0.0, 2.0), (1.5, 0.0)])
def test_from_a_speed_to_another_one_the_time_is_that_of_full_torque(start, end):
    """Of 2 rad with 4 rad/s^2, of which 99 % are used: v_peak^2 = a L + (v_0^2 + v_1^2) / 2."""
    given = RetimingLimits(limits(velocity=20.0), np.array([8.0]), jerk=False)
    ends = EndVelocities(np.array([start]), np.array([end]))
    found = retimed(np.linspace(0.0, 2.0, 50)[:, None], ("q",), given, inertia, ends)
    a = RETIMED_LIMIT_SHARE * 4.0
    peak = np.sqrt(2.0 * a + (start**2 + end**2) / 2.0)
    assert found.time[-1] == pytest.approx((2.0 * peak - start - end) / a, rel=0.01)
    assert found.v[[0, -1], 0] == pytest.approx([start, end], abs=1e-9)
    assert found.q[[0, -1], 0] == pytest.approx([0.0, 2.0], abs=1e-9)


@pytest.mark.parametrize(("start", "end"), [(1.0, 0.5), (0.0, 1.8), (1.5, 0.0), (0.3, 0.3)])
def test_with_a_jerk_limit_ends_in_motion_cost_a_quarter_over_the_optimum_at_most(start, end):
    """The optimum is ruckig's: any acceleration between, none at the ends."""
    given, ends = RetimingLimits(limits(), np.array([np.inf])), EndVelocities(np.array([start]), np.array([end]))
    found = retimed(np.linspace(0.0, 2.0, 50)[:, None], ("q",), given, lambda q, v, a: (0 * v + 0 * a, 0 * q), ends)
    wanted = ruckig.InputParameter(1)
    wanted.current_position, wanted.current_velocity, wanted.current_acceleration = [0.0], [start], [0.0]
    wanted.target_position, wanted.target_velocity, wanted.target_acceleration = [2.0], [end], [0.0]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [2.0], [5.0], [50.0]
    best = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(wanted, best)
    assert best.duration <= found.time[-1] * 1.001
    assert found.time[-1] <= 1.25 * best.duration
    assert found.v[[0, -1], 0] == pytest.approx([start, end], abs=1e-9)
    h = np.diff(found.time)
    for values, most in ((found.q, 2.0), (found.v, 5.0), (found.a, 50.0)):
        assert np.abs(np.diff(values[:, 0]) / h).max() <= most * 1.0001


def test_no_speed_is_feasible_where_friction_alone_is_more_than_the_limit():
    given = RetimingLimits(limits(), np.array([0.9]))
    with pytest.raises(TaskFailedError, match="q needs 1"):
        retimed(np.linspace(0.0, 2.0, 50)[:, None], ("q",), given, weightless)


@pytest.fixture(scope="module")
def robot():
    return load("ur5")


@pytest.fixture(scope="module")
def points(robot):
    rng = np.random.default_rng(4)
    return robot.home + np.cumsum(rng.uniform(-0.4, 0.4, (8, 6)), axis=0)


def test_a_retimed_motion_is_feasible_and_a_twentieth_faster_is_not(robot, points):
    found = retimed_on_arm(robot, points, AT_REST, CheckSettings())
    settings = CheckSettings(collision=False, min_singular_value=0.0)
    assert check_joints(robot, found, settings).feasible
    scaled = type(found)(found.time / 1.08, found.q, found.v * 1.08, found.a * 1.08**2, found.joint_names)
    assert not check_joints(robot, scaled, settings).feasible
    for point in points:
        assert np.abs(found.q - point).max(axis=1).min() < 0.01


@pytest.mark.parametrize("seed", range(6))
def test_velocities_at_the_ends_are_kept_on_an_arm(robot, seed):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, 200)[:, None]
    size, phase = rng.uniform(0.2, 0.5, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    points, way = robot.home + size * np.sin(3.0 * t + phase), 3.0 * size * np.cos(3.0 * t + phase)
    speeds = rng.uniform(0.1, 0.4, 2)
    ends = EndVelocities(
        *(share * v / (np.abs(v) / robot.limits.velocity).max() for share, v in zip(speeds, way[[0, -1]], strict=True))
    )
    found = retimed_on_arm(robot, points, ends, CheckSettings())
    assert check_joints(robot, found, CheckSettings(collision=False, min_singular_value=0.0)).feasible
    np.testing.assert_allclose(found.v[[0, -1]], [ends.start, ends.end], atol=1e-9)
    np.testing.assert_allclose(found.q[[0, -1]], points[[0, -1]], atol=1e-9)
    rest = retimed_on_arm(robot, points, AT_REST, CheckSettings())
    assert found.time[-1] < rest.time[-1]


def test_velocities_that_no_limit_allows_or_that_leave_the_path_are_refused(robot, points):
    fast = EndVelocities(start=1.5 * robot.limits.velocity * np.sign(points[1] - points[0]))
    with pytest.raises(TaskFailedError, match=r"do not allow the velocities"):
        retimed_on_arm(robot, points, fast, CheckSettings())
    with pytest.raises(TaskFailedError, match="at the start is not along the path"):
        retimed_on_arm(robot, points, EndVelocities(start=points[0] - points[1]), CheckSettings())


def test_waypoints_of_a_table_and_of_ros_are_the_same_path(points, robot, tmp_path, refused):
    names = robot.joint_names
    np.savetxt(tmp_path / "w.csv", points, delimiter=",", header=",".join(f"q.{n} [rad]" for n in names), comments="")
    rows = [{"positions": row[::-1].tolist(), "time_from_start": {"sec": i}} for i, row in enumerate(points)]
    message = {"trajectory": {"joint_trajectory": {"joint_names": names[::-1], "points": rows}}}
    (tmp_path / "w.json").write_text(json.dumps(message))
    answers, again = [], tmp_path / "o.csv"
    for kind in ("csv", "json"):
        status, out, _ = called("check", tmp_path / f"w.{kind}", "--robot", "ur5", "--retime", again, "--json", "-")
        answers.append(json.loads(out))
        assert status == 0
        assert called("check", again, "--robot", "ur5")[0] == 0
    assert answers[0]["retimed"]["seconds"] == pytest.approx(answers[1]["retimed"]["seconds"])
    (tmp_path / "w.json").write_text(json.dumps({"points": [], "joint_names": ["a"]}))
    assert "is missing" in refused("check", tmp_path / "w.json", "--robot", "ur5", "--retime", again)


def test_velocities_of_a_file_and_of_options_hold_at_the_ends(robot, tmp_path, refused):
    names, again, rng = robot.joint_names, tmp_path / "o.csv", np.random.default_rng(0)
    t = np.linspace(0.0, 1.0, 50)[:, None]
    size, phase = rng.uniform(0.2, 0.5, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    q, v = robot.home + size * np.sin(2.0 * t + phase), size * np.cos(2.0 * t + phase)
    heads = ",".join(f"{kind}.{n} [{unit}]" for kind, unit in (("q", "rad"), ("v", "rad/s")) for n in names)
    np.savetxt(tmp_path / "w.csv", np.hstack([q, v]), delimiter=",", header=heads, comments="")
    rows = [{"positions": a.tolist(), "velocities": b.tolist()} for a, b in zip(q, v, strict=True)]
    (tmp_path / "w.json").write_text(json.dumps({"joint_names": names, "points": rows}))
    np.savetxt(tmp_path / "p.csv", q, delimiter=",", header=heads[: heads.index(",v.")], comments="")
    given = [f"--{end}-velocity={','.join(map(repr, row.tolist()))}" for end, row in (("start", v[0]), ("end", v[-1]))]
    for name, options in (("w.csv", []), ("w.json", []), ("p.csv", given)):
        status, out, wrong = called("check", tmp_path / name, "--robot", "ur5", "--retime", again, *options)
        assert status == 0, wrong
        assert "with the velocities that are given at its ends" in out
        found = read_trajectory(again, robot)
        np.testing.assert_allclose(found.v[[0, -1]], v[[0, -1]], atol=1e-6)
        np.testing.assert_allclose(found.q[[0, -1]], q[[0, -1]], atol=1e-6)
    none = f"--start-velocity={','.join(['0'] * 6)}", f"--end-velocity={','.join(['0'] * 6)}"
    status, out, wrong = called("check", tmp_path / "w.csv", "--robot", "ur5", "--retime", again, *none)
    assert status == 0
    assert "from rest to rest" in out
    assert "add --retime" in refused("check", tmp_path / "w.csv", "--robot", "ur5", given[0])
