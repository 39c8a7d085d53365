"""Each benchmark runs in a few seconds with --quick, finds no wrong answer and writes what it found."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..armdyn.arm.conftest import RECORDINGS

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def run(script: str, tmp_path: Path, *options: str) -> dict:
    results = tmp_path / "results.json"
    command = [sys.executable, str(BENCHMARKS / script), *options, "--json", str(results)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "[MISSED]" not in done.stdout
    assert [entry.name for entry in tmp_path.iterdir()] == ["results.json"], "it leaves files where it is run"
    return json.loads(results.read_text())


def test_optimisers_find_the_same_swing(tmp_path: Path) -> None:
    rows = run("rivals/task_optimizer.py", tmp_path, "--quick")["rows"]
    assert {"armdyn", "armdyn, no C compiler", "IPOPT, as stated", "fatrop, RK4"} <= {row["solver"] for row in rows}
    for row in rows:
        assert row["cost"] == pytest.approx(row["best_cost"], abs=1e-6), row["solver"]


@pytest.mark.slow
def test_estimators_find_the_same_length_at_the_bound(tmp_path: Path) -> None:
    found = run("rivals/estimator.py", tmp_path, "--quick")
    assert max(row["off"] for row in found["rows"] if row["off"] is not None) < 0.02
    assert found["efficiency"]["paired"] > 0.9
    assert {row["guess"] for row in found["convergence"]} == {0.15}


def test_action_control_agrees_with_plain_numpy(tmp_path: Path) -> None:
    found = run("rivals/sac.py", tmp_path, "--quick")
    assert max(found["differences"].values()) < 1e-9
    assert found["gradient_error"] < 1e-6


@pytest.mark.slow
def test_a_servo_arm_is_found_untold_and_by_mujocos_own_identification_when_told(tmp_path: Path) -> None:
    if not hasattr(pytest.importorskip("mujoco.sysid"), "optimize"):
        pytest.skip("mujoco.sysid lacks what it needs")
    (both,) = run("rivals/mujoco_sysid.py", tmp_path, "--quick")["cases"].values()
    assert {name: found["held_out"] < 5e-3 for name, found in both.items()} == dict.fromkeys(both, True)
    assert both["armdyn"]["values"]["gain[elbow_flex]"] == pytest.approx(11.5, rel=0.02)


@pytest.mark.slow
def test_action_control_tells_more_than_a_generic_chirp(tmp_path: Path) -> None:
    found = run("rivals/information.py", tmp_path, "--quick")
    assert found["sac"]["full_bound"] < 5e-4
    assert found["sac"]["x"] < 0.2
    assert found["same_peak"]["chirp 0.2-2 Hz"]["information"] < 0.1 * found["sac"]["information"]


@pytest.mark.slow
def test_length_is_learnt_on_the_simulated_robot(tmp_path: Path) -> None:
    trials = run("length.py", tmp_path, "--quick")["trials"]
    assert all(abs(trial["error"]) < 5e-3 for trial in trials)


@pytest.mark.slow
def test_recorded_pendulums_are_answered(tmp_path: Path) -> None:
    found = run("hidden/imperfect_pendulum.py", tmp_path, "--quick")
    rows = [row for kind in ("names", "clean", "fits") for row in found[kind]]
    assert [row["failed"] for row in rows if "failed" in row] == []
    answered = [row for row in rows if not row.get("skipped")]
    assert {"named", "set", "exam", "quiet", "truth", "wrong"} <= set().union(*answered)
    assert all(row["quiet"] for row in found["clean"])


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the public recordings are not there")
def test_a_gyro_on_a_wheel_has_a_bias(tmp_path: Path) -> None:
    (row,) = run("real.py", tmp_path, "--quick", "--data", str(RECORDINGS))["rows"]
    assert row["effects"] == ["sensor_bias"]
    assert row["ratio"] < 1.1


def test_missing_recordings_are_said_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "real.py"), "--data", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert "is missing" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_mistakes_are_named_and_sound_recordings_are_not(tmp_path: Path) -> None:
    found = run("hidden/mistakes.py", tmp_path, "--quick")
    assert found["sound_wrong"] == 0
    assert sum(found["found"].values()) >= 0.95 * sum(found["asked"].values())
