import json
import sys
from pathlib import Path

import numpy as np
import pytest

import ik
import urdf
from armdyn.errors import InputError
from pipeline.console.app import application
from pipeline.motion.feasibility import Margin
from pipeline.motion.feasibility.read import differentiated, noise

TIME = 0.01 * np.arange(200)
S = 0.1 * (1 - np.cos(2 * np.pi * 0.5 * TIME)) * (1 - np.cos(2 * np.pi * TIME / 2)) / 2


def run(*arguments: str | Path) -> int:
    status = application(["check"])(["check", *map(str, arguments)], standalone_mode=False)
    assert isinstance(status, int)
    return status


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


def test_a_feasible_joint_motion_exits_with_0(
    tmp_path: Path, joints: list[str], q: np.ndarray, capsys: pytest.CaptureFixture
) -> None:
    assert run(write(tmp_path / "a.csv", joints, q)) == 0
    assert capsys.readouterr().out.startswith("Feasible")


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_positions_with_few_digits_stay_feasible(tmp_path: Path, joints: list[str], q: np.ndarray, digits: int) -> None:
    assert run(write(tmp_path / "a.csv", joints, q, digits)) == 0


def test_columns_in_any_order_are_the_same_motion(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    answers = []
    for name, order in (("a", slice(None)), ("b", slice(None, None, -1))):
        file = tmp_path / f"{name}.json"
        run(write(tmp_path / f"{name}.csv", joints[order], q[:, order]), "--json", file)
        answers.append(json.loads(file.read_text()))
    assert answers[0] == answers[1]


def test_degrees_with_their_unit_are_converted(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    header = [name.replace("rad", "deg") for name in joints]
    assert run(write(tmp_path / "a.csv", header, np.degrees(q))) == 0


@pytest.mark.parametrize("column", ["s [m]", "gripper_x [m]", "s [mm]"])
def test_a_line_motion_may_have_either_name(tmp_path: Path, column: str) -> None:
    factor = 1000.0 if "mm" in column else 1.0
    assert run(write(tmp_path / "a.csv", [column], factor * S)) == 0


def test_a_motion_that_is_too_fast_exits_with_1_and_says_which_joint(
    tmp_path: Path, joints: list[str], q: np.ndarray
) -> None:
    file = tmp_path / "a.json"
    assert run(write(tmp_path / "a.csv", joints, q, time=TIME / 4), "--json", file) == 1
    answer = json.loads(file.read_text())
    assert not answer["feasible"]
    assert {"velocity", "acceleration"} <= {v["limit"] for v in answer["violations"]}
    assert {v["joint"] for v in answer["violations"]} <= {name[2:-6] for name in joints}


def test_json_on_standard_output_is_all_that_is_there(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    run(write(tmp_path / "a.csv", ["s [m]"], S), "--json", "-")
    assert json.loads(capsys.readouterr().out)["schema"] == "armdyn.check/1"


def test_the_report_is_one_offline_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["armdyn", "check", "a.csv"])
    page = tmp_path / "a.html"
    run(write(tmp_path / "a.csv", ["s [m]"], S), "--report", page)
    text = page.read_text()
    assert "Limits over time" in text
    assert "<script src" not in text


def test_a_start_elsewhere_exits_with_1(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    file = write(tmp_path / "a.csv", joints, q)
    here = ",".join(f"{value:.6f}" for value in q[0])
    assert run(file, "--start", here) == 0
    assert run(file, "--start", ",".join(["0"] * 7)) == 1


def bad(
    tmp_path: Path, header: list[str], columns: np.ndarray, match: str, *options: str, time: np.ndarray = TIME
) -> None:
    file = write(tmp_path / "bad.csv", header, columns, time=time)
    with pytest.raises(InputError, match=match) as caught:
        run(file, *options)
    assert "\n" not in str(caught.value)


def test_degrees_in_place_of_radians_are_recognised(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    bad(tmp_path, joints, np.degrees(q), "looks like degrees")


def test_a_wrong_joint_name_is_named_with_the_right_one(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    bad(tmp_path, ["q.right_s7 [rad]", *joints[1:]], q, "did you mean 'right_s")


def test_a_missing_joint_is_named(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    bad(tmp_path, joints[:-1], q[:, :-1], "right_w2 is missing")


def test_unsorted_time_is_named_with_its_row(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    time = TIME.copy()
    time[[50, 51]] = time[[51, 50]]
    bad(tmp_path, joints, q, "row 53: time does not increase", time=time)
    bad(tmp_path, ["s [m]"], S, "time does not increase", time=time)


def test_a_missing_sample_is_named_with_its_time(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    q[30, 2] = np.nan
    bad(tmp_path, joints, q, r"right_e0 has no sample at 0\.3 s")
    bad(tmp_path, ["s [m]"], np.where(np.arange(TIME.size) == 7, np.nan, S), "row 9, column 's'")


@pytest.mark.parametrize(
    ("header", "match"),
    [
        (["s"], "has no unit"),
        (["s [rad]"], "column 's'"),
        (["s [m]", "speed [m/s]"], "unknown column"),
        (["s [m]", "s [m]"], "are both 's'"),
    ],
)
def test_a_bad_header_is_named(tmp_path: Path, header: list[str], match: str) -> None:
    bad(tmp_path, header, np.column_stack([S] * len(header)), match)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (("--load-mass", "-1 kg"), "not negative"),
        (("--load-mass", "3 m"), "load-mass"),
        (("--start", "1,2"), "7 numbers"),
    ],
)
def test_bad_options_are_named(tmp_path: Path, options: tuple[str, str], match: str) -> None:
    bad(tmp_path, ["s [m]"], S, match, *options)


def test_files_that_are_no_trajectory_are_named(tmp_path: Path) -> None:
    for file, match in ((tmp_path / "none.csv", "no such file"), (tmp_path, "directory")):
        with pytest.raises(InputError, match=match):
            run(file)
    empty = tmp_path / "force.csv"
    bad(tmp_path, ["load_force [N]"], S + 1.0, "no motion in it")
    empty.write_text("")
    with pytest.raises(InputError, match="empty"):
        run(empty)


def test_the_noise_of_positions_is_found_under_their_motion() -> None:
    rng = np.random.default_rng(0)
    for std in (1e-5, 1e-4, 1e-3):
        assert noise(TIME, S + rng.normal(0.0, std, S.size)) == pytest.approx(std, rel=0.25)


def test_derivatives_of_noisy_positions_are_near_the_true_ones() -> None:
    t = 0.01 * np.arange(400)
    clean, rng = np.sin(2 * np.pi * 0.5 * t), np.random.default_rng(1)
    q, v, a = differentiated(t, (clean + rng.normal(0.0, 3e-4, t.size))[:, None])
    w, inside = 2 * np.pi * 0.5, slice(30, -30)
    assert np.max(np.abs(v[inside, 0] - w * np.cos(w * t[inside]))) < 0.02 * w
    assert np.max(np.abs(a[inside, 0] + w**2 * clean[inside])) < 0.1 * w**2
    assert np.max(np.abs(q[inside, 0] - clean[inside])) < 3e-4


def test_derivatives_of_clean_positions_are_exact() -> None:
    w = 2 * np.pi * 0.7
    _, v, a = differentiated(TIME, np.sin(w * TIME)[:, None])
    assert np.max(np.abs(v[:, 0] - w * np.cos(w * TIME))) < 1e-6
    assert np.max(np.abs(a[:, 0] + w**2 * np.sin(w * TIME))) < 1e-3


def test_away_from_the_line_there_is_no_box(tmp_path: Path, joints: list[str], q: np.ndarray) -> None:
    """The box is where the tool's line is: a motion that begins elsewhere is another task."""
    answers = {}
    for name, shift in (("on", 0.0), ("off", 0.5)):
        moved = q + np.concatenate([[shift], np.zeros(q.shape[1] - 1)])
        run(write(tmp_path / f"{name}.csv", joints, moved), "--json", tmp_path / f"{name}.json")
        answers[name] = {
            name
            for margins in json.loads((tmp_path / f"{name}.json").read_text())["margins"].values()
            for name in margins
        }
    gone = answers["on"] - answers["off"]
    assert gone
    assert all("box" in name or "table" in name for name in gone)


def test_a_robot_is_named_or_described_by_a_urdf(tmp_path: Path) -> None:
    ur5 = urdf.load("ur5")
    path = tmp_path / "ur5.urdf"
    path.write_text(ur5.urdf_xml)
    still = np.tile(ur5.home, (len(TIME), 1))
    file = write(tmp_path / "a.csv", [f"q.{name} [rad]" for name in ur5.joint_names], still)
    assert run(file, "--urdf", path) in (0, 1)
    with pytest.raises(InputError, match="one of --robot and --urdf"):
        run(file, "--urdf", path, "--robot", "ur5")


def test_a_distance_says_what_is_the_least() -> None:
    kept = Margin("clearance", "hand and table", 0.2, 0.309, 0.010, "m", 0.299, 0.03)
    assert str(kept) == "0.309 m, at least 0.01 m, at 0.200 s"
    speed = Margin("velocity", "elbow", 0.2, 1.8, 2.0, "rad/s", 0.2, 0.9)
    assert str(speed) == "1.8 of 2 rad/s at 0.200 s"
    low = Margin("position", "elbow", 0.2, -1.6, -1.7, "rad", 0.1, 0.9)
    assert str(low) == "-1.6 of -1.7 rad at 0.200 s"
