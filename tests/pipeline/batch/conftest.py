import sys

import pytest
from hidden_effects.lab import Change, Lab

from pipeline.cli import main

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


@pytest.fixture
def lab(logs, tmp_path, monkeypatch):
    """A folder with a SPEC and the logs; its files are links, so that a test may replace one."""
    for path in logs.rglob("*.*"):
        target = tmp_path / "robots" / path.relative_to(logs)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(path)
    (tmp_path / "spec.toml").write_text(SPEC)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def armdyn(monkeypatch, capsys):
    """Runs a command; its exit status, what it printed, what it complained of."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["armdyn", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        return stop.value.code, *capsys.readouterr()

    return run
