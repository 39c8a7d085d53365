"""The table of a line, held against other libraries and against differences."""

from dataclasses import fields, is_dataclass, replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ik
import urdf
from armdyn.errors import InputError


def slope(values: np.ndarray, step: float) -> np.ndarray:
    """Differences of fourth order of values at even steps, two fewer at either end."""
    return (8 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12 * step)


def test_tools_are_on_their_lines_between_nodes_by_yourdfpy(robot, tables, tool_poses) -> None:
    table, line = tables(robot), robot.line
    s = np.random.default_rng(3).uniform(line.s_min, line.s_max, 40)
    rotation, position = tool_poses(robot, table.posture(s).q)
    assert np.abs(position - (line.origin + s[:, None] * line.direction)).max() < 1e-9  # m
    assert Rotation.from_matrix(rotation.transpose(0, 2, 1) @ line.rotation).magnitude().max() < 1e-8  # rad


def test_derivatives_agree_with_differences_of_the_nodes(robot, tables) -> None:
    table = tables(robot)
    step = table.s[1] - table.s[0]
    assert np.abs(slope(table.q, step) - table.dq_ds[2:-2]).max() < 1e-8
    assert np.abs(slope(table.dq_ds, step) - table.d2q_ds2[2:-2]).max() < 1e-5 * np.abs(table.d2q_ds2).max()


def test_lines_keep_what_the_settings_say_of_them(robot, tables) -> None:
    table = tables(robot)
    assert table.speed_limit_at(np.linspace(*robot.line.core, 2001)).min() >= min(robot.line.core_speed, 1.0 + 1e-9)
    assert table.torque_share.max() < 1.0
    margin = robot.limits.margin(table.posture(np.linspace(robot.line.s_min, robot.line.s_max, 3001)).q)
    assert margin.min() >= (0.5 if robot.name == "baxter" else 0.45)
    assert table.joint_margin == pytest.approx(margin.min(), abs=1e-5)
    collisions = urdf.CollisionModel(robot)
    assert all(collisions.touching(q) is None for q in table.q[::40])


def test_jacobian_turns_joint_rates_into_the_motion_along_the_line(table, baxter) -> None:
    twist = np.einsum("kij,kj->ki", table.jacobian, table.dq_ds)
    assert np.abs(twist - [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]).max() < 1e-10
    values = [np.linalg.svd(table.jacobian[:, rows], compute_uv=False) for rows in (slice(0, 3), slice(3, 6))]
    assert table.manipulability == pytest.approx(np.prod(values, axis=-1).T)
    assert table.manipulability.min() > 0.01
    assert np.array_equal(table.margin, baxter.limits.margin(table.q))
    assert table.joint_margin == table.margin.min()


@given(s=st.floats(-0.30, 0.55))
def test_at_the_speed_limit_the_fastest_joint_is_at_its_limit(table, baxter, s: float) -> None:
    rates = np.abs(table.joint_motion(s, table.speed_limit_at(s), 0.0).v)
    assert (rates / baxter.limits.velocity).max() == pytest.approx(1.0, abs=1e-12)


@given(s=st.floats(-0.30, 0.55), share=st.floats(-1.0, 1.0), push=st.sampled_from([-1.0, 1.0]))
def test_within_both_line_limits_no_joint_exceeds_its_acceleration(
    table, baxter, s: float, share: float, push: float
) -> None:
    speed = share * table.speed_limit_at(s)
    motion = table.joint_motion(s, speed, push * table.acceleration_limit_at(s))
    assert (np.abs(motion.a) / baxter.limits.acceleration).max() <= 1.0 + 1e-12


def test_joint_motion_agrees_with_differences_in_time(table) -> None:
    def s_at(t):
        return 0.1 + 0.15 * np.sin(4.0 * t)

    t, step = np.linspace(0.0, 1.5, 40), 1e-4
    motion = table.joint_motion(s_at(t), 0.6 * np.cos(4.0 * t), -2.4 * np.sin(4.0 * t))
    before, here, after = (table.posture(s_at(t + k * step)).q for k in (-1, 0, 1))
    assert np.abs((after - before) / (2 * step) - motion.v).max() < 1e-5
    assert np.abs((after - 2 * here + before) / step**2 - motion.a).max() < 1e-4


@pytest.mark.parametrize("s", [-0.31, 0.56, float("nan"), [0.0, 2.0]])
def test_a_coordinate_off_the_table_is_refused(table, s, complains) -> None:
    with complains(InputError):
        table.posture(s)


def test_torque_along_the_line_agrees_with_mujocos_inverse_dynamics(table, baxter_plant) -> None:
    data = mujoco.MjData(baxter_plant)
    rng = np.random.default_rng(2)
    for s, v, a in zip(rng.uniform(-0.3, 0.55, 20), rng.uniform(-1, 1, 20), rng.uniform(-8, 8, 20), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = table.joint_motion(s, v, a)
        mujoco.mj_inverse(baxter_plant, data)
        assert table.torque.interpolate(table.s, s).torque(v, a) == pytest.approx(data.qfrc_inverse, abs=2e-4)


def test_springs_take_their_torque_off_the_motor(table, baxter) -> None:
    without, helped = (table.torque.interpolate(table.s, 0.1).torque(0.0, 0.0, springs) for springs in (False, True))
    shoulder = table.posture(0.1).q[1]
    assert (helped - without)[1] == pytest.approx(8.2 * np.sin(shoulder) + 35.3 * np.cos(shoulder), abs=1e-6)
    assert np.delete(without - helped, 1).tolist() == [0.0] * 6
    assert abs(helped[1]) < abs(without[1])
    assert baxter.springs[0].enabled is False
    assert table.torque_share[:, 0].max() < 1.0
    assert table.torque_share[:, 1].max() < 0.6 * table.torque_share[:, 0].max()


@pytest.mark.parametrize("springs", [False, True])
def test_at_either_end_of_the_acceleration_range_one_motor_is_at_its_limit(table, springs: bool) -> None:
    s, v = np.linspace(-0.3, 0.55, 40), np.linspace(-0.4, 0.4, 40)
    for a in table.torque_acceleration_range(s, v, springs):
        share = np.abs(table.torque.interpolate(table.s, s).torque(v, a, springs)) / table.limits.effort
        assert share.max(axis=1) == pytest.approx(1.0, abs=1e-9)
    low, high = table.torque_acceleration_range(s, v, springs)
    assert (low < 0).all()
    assert (high > 0).all()


def test_a_saved_table_is_read_back_to_the_last_digit(saved, table, baxter) -> None:
    read = ik.LineTable.load(saved, baxter)
    for part in (None, "torque", "line", "limits"):
        one, other = (of if part is None else getattr(of, part) for of in (read, table))
        for item in fields(other):
            if not is_dataclass(getattr(other, item.name)):
                assert np.array_equal(getattr(one, item.name), getattr(other, item.name)), item.name


def test_a_table_of_another_robot_or_whose_numbers_were_changed_or_taken_out_is_refused(
    saved, baxter, table, tmp_path, complains
) -> None:
    with complains(InputError):
        ik.LineTable.load(tmp_path / "none.npz", baxter)
    with complains(InputError):
        table.save(tmp_path / "nowhere" / "table.npz")
    for changed in ({"fingerprint": "0" * 64}, {"name": "ur5"}):
        with complains(ik.StaleTableError):
            ik.LineTable.load(saved, replace(baxter, **changed))
    with np.load(saved) as file:
        content = dict(file)
    q = table.q.copy()
    q[100, 3] += 1e-6
    for other in (content | {"q": q}, {name: x for name, x in content.items() if name != "jacobian"}):
        np.savez(saved, **other)
        with complains(ik.StaleTableError):
            ik.LineTable.load(saved, baxter)


def test_the_default_table_is_built_once_and_again_when_damaged(baxter, table, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("ARMDYN_CACHE", str(tmp_path))
    stages: list[str] = []
    built = ik.default_table(baxter, progress=stages.append)
    assert stages
    assert np.abs(built.q - table.q).max() < 1e-9
    stages.clear()
    ik.default_table(baxter, progress=stages.append)
    assert not stages
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:5000])
    assert ik.default_table(baxter, progress=stages.append).joint_margin == pytest.approx(table.joint_margin)
    assert stages
