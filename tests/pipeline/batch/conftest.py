import contextlib
import shutil
from functools import cache

import pytest
from command import called
from worlds.lab import Change, Lab

SPEC = """task = "compare"
[[recordings]]
model = "robots/{robot}/model.toml"
runs = ["robots/{robot}/logs/*.csv"]
"""
LAB = Lab(robots=2, recordings=12, changes={1: Change(7, tool=0.3)}, seconds=2.5)


@pytest.fixture(scope="session")
def logs(tmp_path_factory):
    """Two robots with twelve recordings each; the second one's tool is 0.3 kg heavier from the eighth on."""
    folder = tmp_path_factory.mktemp("lab")
    LAB.write(folder / "robots")
    return folder / "robots"


FEW = 4


def linked(logs, folder, few=False):
    """The logs, or `FEW` of the first robot, as links, so that a test may replace one; and a SPEC."""
    paths = sorted(logs.rglob("*.*"))
    if few:
        paths = [path for path in paths if "robot_00" in str(path)]
        paths = [p for p in paths if p.suffix == ".csv"][:FEW] + [p for p in paths if p.name == "model.toml"]
    for path in paths:
        target = folder / "robots" / path.relative_to(logs)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(path)
    (folder / "spec.toml").write_text(SPEC)
    return folder


@pytest.fixture
def lab(logs, tmp_path, monkeypatch):
    """A folder with a SPEC and `FEW` logs."""
    monkeypatch.chdir(tmp_path)
    return linked(logs, tmp_path, few=True)


@pytest.fixture(scope="session")
def finished(logs, tmp_path_factory):
    """A batch that is done, of few logs or of all, and what it printed."""

    @cache
    def of(few):
        folder = linked(logs, tmp_path_factory.mktemp("finished"), few)
        with contextlib.chdir(folder):
            status, out, _ = called("batch", "spec.toml", "--output", "out", "--workers", "1", "--json", "out.json")
        assert status == 0
        return folder, out

    return of


def copied(finished, lab):
    shutil.copytree(finished[0] / "out", lab / "out")
    shutil.copy(finished[0] / "out.json", lab)
    return lab, finished[1]


@pytest.fixture
def done(finished, lab):
    """A finished batch of `FEW` logs to go on with, and what it printed."""
    return copied(finished(True), lab)


@pytest.fixture
def whole(logs, tmp_path, monkeypatch, finished):
    """The same of both robots and all their logs."""
    monkeypatch.chdir(tmp_path)
    return copied(finished(False), linked(logs, tmp_path))
