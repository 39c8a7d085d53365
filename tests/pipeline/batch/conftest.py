import contextlib
import shutil

import pytest
from command import called
from worlds.lab import Lab

FEW = 4
SPEC = """task = "compare"
[[recordings]]
model = "robots/{robot}/model.toml"
runs = ["robots/{robot}/logs/*.csv"]
"""
BATCH = ("batch", "spec.toml", "--output", "out", "--workers", "1", "--json", "out.json")


@pytest.fixture(scope="session")
def logs(tmp_path_factory):
    """A robot with `FEW` recordings, and a SPEC."""
    folder = tmp_path_factory.mktemp("lab")
    Lab(robots=1, recordings=FEW, seconds=2.5).write(folder / "robots")
    (folder / "spec.toml").write_text(SPEC)
    return folder


@pytest.fixture(scope="session")
def finished(logs, tmp_path_factory):
    """A batch of them that is done."""
    folder = shutil.copytree(logs, tmp_path_factory.mktemp("finished"), dirs_exist_ok=True)
    with contextlib.chdir(folder):
        assert called(*BATCH)[0] == 0
    return folder


@pytest.fixture
def lab(logs, tmp_path, monkeypatch):
    """A copy to work on."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(logs, tmp_path, dirs_exist_ok=True)


@pytest.fixture
def done(lab, finished):
    """A finished batch to go on with: what was read is where and as it was."""
    for name in ("out", "out.json"):
        (shutil.copytree if name == "out" else shutil.copy)(finished / name, lab / name)
    return lab
