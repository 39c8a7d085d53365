"""The wheel, installed in an environment of its own and used from an empty folder, does what the README says."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow


def run(*command, **options):
    """What a process printed; it must end with status 0."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Python of a fresh environment with the wheel; what pip cannot get is a reason to skip."""
    folder = tmp_path_factory.mktemp("wheel")
    source, left_out = folder / "source", (".venv", ".git", "out", "site", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*left_out))
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, source)
    (wheel,) = folder.glob("armdyn-*.whl")
    run(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv/bin/python"
    run(python, "-m", "pip", "install", "--quiet", wheel, f"armdyn[batch] @ {wheel.as_uri()}")
    return python


@pytest.fixture
def armdyn(python, tmp_path, monkeypatch):
    """Runs a command of the installed wheel from an empty folder; returns what it printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    return lambda *words: run(python.parent / "armdyn", *map(str, words), timeout=600)


def test_it_comes_from_the_wheel_and_a_trial_lands(armdyn, python, tmp_path):
    code = "import armdyn, ik, pipeline, urdf; print(armdyn.__file__, pipeline.__file__)"
    assert run(python, "-c", code).count("site-packages") == 2
    assert "box" in armdyn("trial", "--no-estimation", "--length-guess", "0.368")
    assert (tmp_path / "out/trial/report.html").stat().st_size > 500_000


def test_a_pendulum_is_made_repaired_and_exported(armdyn, tmp_path):
    swings = [ROOT / f"examples/pendulum/swing_{number}.csv" for number in (1, 2)]
    armdyn("new", "pendulum", "m.toml")
    armdyn("repair", "m.toml", *swings, "--output", "r.toml", "--report", "r.html", "--json", "r.json")
    assert json.loads((tmp_path / "r.json").read_text())["effects"] == ["quadratic_drag"]
    armdyn("export", "r.toml", "--output", "step.py")
    assert "def step" in (tmp_path / "step.py").read_text()


def test_an_arm_is_made_checked_and_exported(armdyn, tmp_path):
    armdyn("new", "arm", "ur5.toml", "--robot", "ur5")
    armdyn("export", "ur5.toml", "--output", "ur5.xml")
    assert "<mujoco" in (tmp_path / "ur5.xml").read_text()
    armdyn("ik", "build", "--out", "t.npz")
    assert "right_s0" in armdyn("ik", "show", "t.npz")


def test_a_batch_runs(armdyn, tmp_path):
    for number in (1, 2):
        shutil.copy(ROOT / f"examples/pendulum/swing_{number}.csv", tmp_path / f"swing_2026-05-0{number}.csv")
    (tmp_path / "spec.toml").write_text('[[recordings]]\nmodel = "m.toml"\nruns = ["swing_*.csv"]\n')
    armdyn("new", "pendulum", "m.toml")
    assert "2 recordings of 1 robots" in armdyn("batch", "spec.toml", "--output", "out")
    assert (tmp_path / "out/batch.parquet").exists()


def test_what_is_not_installed_is_named(armdyn):
    with pytest.raises(AssertionError, match=r"pip install 'armdyn\[ros\]'"):
        armdyn("record", "--ros", "ws://127.0.0.1:9", "--output", "r.csv", "--seconds", "1")
