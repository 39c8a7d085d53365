import json
import re
from pathlib import Path

import numpy as np
import pytest
from command import called

import ik
import urdf
from armdyn.recording.noise import noise_std_from_differences
from pipeline.motion.feasibility.read import NOISE_DIFFERENCE_ORDER, smooth_and_differentiate

TIME = 0.01 * np.arange(200)
S = 0.1 * (1 - np.cos(2 * np.pi * 0.5 * TIME)) * (1 - np.cos(2 * np.pi * TIME / 2)) / 2


def run(*arguments: str | Path) -> int:
    return called("check", *arguments)[0]


def write(path: Path, header: list[str], columns: np.ndarray, digits: int = 8, time: np.ndarray = TIME) -> Path:
    rows = np.column_stack([time, columns])
    np.savetxt(path, rows, delimiter=",", header=",".join(["time [s]", *header]), comments="", fmt=f"%.{digits}f")
    return path


@pytest.fixture
def joints(robot: urdf.Robot) -> list[str]:
    return [f"q.{name} [rad]" for name in robot.joint_names]


@pytest.fixture
def q(table: ik.LineTable) -> np.ndarray:
    return np.array(table.posture(S).q)


def answer(*arguments: str | Path) -> tuple[int, dict]:
    status, out, _ = called("check", *arguments, "--json", "-")
    return status, json.loads(out)


def test_a_feasible_joint_motion_exits_with_0(tmp_path, joints, q):
    """So do positions with few digits, and degrees that say so."""
    for digits in (3, 4, 8):
        assert run(write(tmp_path / "a.csv", joints, q, digits)) == 0
    assert run(write(tmp_path / "a.csv", [name.replace("rad", "deg") for name in joints], np.degrees(q))) == 0


def test_columns_in_any_order_and_either_name_of_the_line_are_the_same_motion(tmp_path, joints, q):
    orders = [slice(None), slice(None, None, -1)]
    one, other = (answer(write(tmp_path / "a.csv", joints[order], q[:, order])) for order in orders)
    assert one == other
    for column, unit in (("s [m]", 1.0), ("gripper_x [m]", 1.0), ("s [mm]", 1e3)):
        assert run(write(tmp_path / "a.csv", [column], unit * S)) == 0


def test_a_retiming_is_proposed_with_the_load_of_the_check(tmp_path, joints, q):
    file = write(tmp_path / "a.csv", joints, q, time=0.1 * TIME)
    _, out, _ = called("check", file, "--load-mass", "300 g", "--no-springs")
    (line,) = [line for line in out.splitlines() if line.startswith("retime it: ")]
    assert line.endswith("--load-mass '300 g' --no-springs --retime retimed.csv")


def test_a_motion_that_is_too_fast_exits_with_1_and_says_which_joint(tmp_path, joints, q):
    status, found = answer(write(tmp_path / "a.csv", joints, q, time=TIME / 4))
    assert status == 1
    assert not found["feasible"]
    assert {"velocity", "acceleration"} <= {v["limit"] for v in found["violations"]}
    assert {v["joint"] for v in found["violations"]} <= {name[2:-6] for name in joints}


def test_a_start_elsewhere_exits_with_1(tmp_path, joints, q):
    file = write(tmp_path / "a.csv", joints, q)
    assert run(file, "--start", ",".join(f"{value:.6f}" for value in q[0])) == 0
    assert run(file, "--start", ",".join(["0"] * 7)) == 1


SWAPPED = np.concatenate([TIME[:50], TIME[[51, 50]], TIME[52:]])
HOLE = np.where(np.arange(TIME.size) == 30, np.nan, 1.0)


WRONG = [
    ("joints", np.degrees, (), "looks like degrees"), ("renamed", None, (), "did you mean 'right_s"),
    ("missing", None, (), "right_w2 is missing"), ("joints", SWAPPED, (), "row 53: time does not increase"),
    (["s [m]"], SWAPPED, (), "time does not increase"), ("joints", HOLE, (), r"right_s0 has no sample at 0\.3 s"),
    (["s [m]"], HOLE, (), "row 32, column 's'"), (["s"], None, (), "has no unit"),
    (["s [rad]"], None, (), "column 's'"), (["s [m]", "speed [m/s]"], None, (), "unknown column"),
    (["s [m]", "s [m]"], None, (), "are both 's'"), (["load_force [N]"], None, (), "no motion in it"),
    (["s [m]"], None, ("--load-mass", "-1 kg"), "not negative"), (["s [m]"], None, ("--load-mass", "3 m"), "load-mass"),
    (["s [m]"], None, ("--start", "1,2"), "7 numbers"),
]  # fmt: skip


@pytest.mark.parametrize(("header", "columns", "options", "match"), WRONG)
def test_what_is_wrong_is_one_line(refused, tmp_path, joints, q, header, columns, options, match):
    names = {"joints": joints, "renamed": ["q.right_s7 [rad]", *joints[1:]], "missing": joints[:-1]}
    header = names.get(header, header) if isinstance(header, str) else header
    values = np.array(q[:, : len(header)]) if header[0].startswith("q.") else np.column_stack([S] * len(header))
    if columns is HOLE:
        values[:, 0] *= HOLE
    elif callable(columns):
        values = columns(values)
    file = write(tmp_path / "bad.csv", header, values, time=SWAPPED if columns is SWAPPED else TIME)
    assert re.search(match, refused("check", file, *options))


@pytest.mark.parametrize("name", ["none.csv", ".", "empty.csv"])
def test_files_that_are_no_trajectory_are_named(refused, tmp_path, name, complains):
    (tmp_path / "empty.csv").touch()
    complains.line(refused("check", name))


def test_the_noise_of_positions_is_found_under_their_motion():
    rng = np.random.default_rng(0)
    for std in (1e-5, 1e-3):
        assert noise_std_from_differences(
            TIME, S + rng.normal(0.0, std, S.size), NOISE_DIFFERENCE_ORDER
        ) == pytest.approx(std, rel=0.25)


@pytest.mark.parametrize(
    ("noise", "tolerances"), [(0.0, (1e-9, 1e-6, 1e-3)), (3e-4, (3e-4, 0.06, 1.0))], ids=["clean", "noisy"]
)
def test_derivatives_of_positions_are_near_the_true_ones(noise, tolerances):
    t, w, inside = 0.01 * np.arange(400), np.pi, slice(30, -30)
    clean = np.sin(w * t)
    found = smooth_and_differentiate(t, (clean + np.random.default_rng(1).normal(0.0, noise, t.size))[:, None])
    for have, true, tolerance in zip(found, (clean, w * np.cos(w * t), -(w**2) * clean), tolerances, strict=True):
        assert np.max(np.abs(have[inside, 0] - true[inside])) < tolerance


def test_away_from_the_line_there_is_no_box(tmp_path, joints, q):
    """The box is where the tool's line is: a motion that begins elsewhere is another task."""
    looked_at = []
    for shift in (0.0, 0.5):
        moved = q + np.concatenate([[shift], np.zeros(q.shape[1] - 1)])
        _, found = answer(write(tmp_path / "a.csv", joints, moved))
        looked_at.append({name for margins in found["margins"].values() for name in margins})
    gone = looked_at[0] - looked_at[1]
    assert gone
    assert all("box" in name or "table" in name for name in gone)


def test_a_robot_is_named_or_described_by_a_urdf(tmp_path):
    ur5 = urdf.load("ur5")
    (tmp_path / "ur5.urdf").write_text(ur5.urdf_xml)
    still = np.tile(ur5.home, (len(TIME), 1))
    file = write(tmp_path / "a.csv", [f"q.{name} [rad]" for name in ur5.joint_names], still)
    assert run(file, "--urdf", tmp_path / "ur5.urdf") in (0, 1)
