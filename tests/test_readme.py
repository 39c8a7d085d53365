"""What the README and the pages for users promise."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import armdyn
from armdyn import __version__
from armdyn.run import read_run, write_run_csv
from pipeline.imports.mapping import read_map

from .armdyn.arm import urdfs

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
FORMATS = (ROOT / "docs/formats.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README + FORMATS, re.DOTALL)


FRICTION = np.array([2.0, 0.5])
"""Viscous friction of the two joints that the examples' robot has, N m s/rad."""


def robot_with_recordings(folder):
    """An arm of two joints as its URDF describes it, and recordings of one that has friction, by Pinocchio."""
    model = urdfs.arm(folder, urdfs.DOUBLE)
    robot, joints = model.arm.model, model.arm.joints

    def torque(q, v, a):
        data = robot.createData()
        return np.array([pin.rnea(robot, data, *row) for row in zip(q, v, a, strict=True)]) + FRICTION * v

    armdyn.save(model, folder / "robot.toml")
    for seed, name in enumerate(("runs/log.csv", "runs/another.csv", "motion.csv")):
        (folder / name).parent.mkdir(exist_ok=True)
        run = urdfs.recorded(joints, ["rad", "rad"], torque, seed=seed)
        moved = {channel: c for channel, c in run.channels.items() if name != "motion.csv" or channel[0] == "q"}
        write_run_csv(replace(run, channels=moved), folder / name)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda text: text.split("\n")[0][:40])
def test_examples_run(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    robot_with_recordings(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    said = capsys.readouterr().out
    if "armdyn.repair" in example:
        assert said.startswith("joint_viscous_friction")
        assert "easible" in said
        friction = [
            armdyn.load("repaired.toml").value(f"joint_viscous_friction.coefficient[{j}]") for j in ("swing", "elbow")
        ]
        assert friction == pytest.approx(FRICTION, rel=0.01)
        assert "plotly" in Path("found.html").read_text("utf-8")


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/your_robot.md", "docs/formats.md"])
def test_links_and_pictures_exist(page):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", (ROOT / page).read_text())
    missing = [target for target in targets if target and not ((ROOT / page).parent / target).exists()]
    assert targets
    assert not missing


def test_two_commands_do_the_setting_up():
    commands = re.search(r"```sh\n(.*?)```", README, re.DOTALL).group(1).strip().splitlines()
    assert len(commands) == 2
    assert commands[0].endswith("armdyn trial")
    assert commands[1].endswith("pytest -n auto")


def test_the_run_that_is_shown_is_one(tmp_path):
    header, *rows = re.search(r"```\n(time \[s\].*?)```", FORMATS, re.DOTALL)[1].strip().splitlines()
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join([header, *(row.replace(row[:5], f"{i / 100:.3f}") for i, row in enumerate(rows * 5))]) + "\n"
    )
    sidecar = re.search(r"```toml\n(description = \"swing.*?)```", FORMATS, re.DOTALL)[1]
    path.with_suffix(".toml").write_text(sidecar)
    run = read_run(path)
    assert run.joints == ("shoulder", "elbow")
    assert run.noise == {"load_force": 0.003, "tau.elbow": 0.2}


def test_the_mapping_that_is_shown_is_one(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(re.search(r"```toml\n(time = .*?)```", FORMATS, re.DOTALL)[1])
    assert [entry.channel for entry in read_map(path)[""].entries.values()] == ["q.shoulder", "q.elbow", "tau.elbow"]


def test_every_file_says_the_same_version():
    versions = [
        re.search(r'^version:? ?=? ?"?([0-9.]+)"?$', (ROOT / name).read_text(), re.MULTILINE)[1]
        for name in ("pyproject.toml", "CITATION.cff")
    ]
    assert versions == [__version__] * 2


def test_the_command_tells_its_version(armdyn):
    assert armdyn("--version")[:2] == (0, f"armdyn {__version__}\n")
