"""Commands that others work for: killed at any instant, nobody is left behind; a signal is their exit status."""

import signal
import subprocess
import sys

import pytest
from descendants import PATIENCE, becomes, linux, marked, of_mark
from worlds.lab import Lab

SPEC = 'task = "repair"\n[[recordings]]\nmodel = "robots/{robot}/model.toml"\nruns = ["robots/{robot}/logs/*.csv"]\n'
ARMDYN = (sys.executable, "-m", "pipeline.cli")
VOLUME = """
from ik.volume import TargetGrid, build_volume
import numpy as np, sys, urdf
if __name__ == "__main__":
    baxter = urdf.load("baxter")
    low, high = np.array([0.6, -0.5, -0.2]), np.array([0.9, -0.1, 0.2])
    build_volume(baxter, TargetGrid(low, high, (40, 40, 40), baxter.line.rotation[None]), sys.argv[1], processes=2)
"""
pytestmark = [linux, pytest.mark.slow]


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    pytest.importorskip("pyarrow", reason="needs the extra 'batch'")
    folder = tmp_path_factory.mktemp("lab")
    Lab(robots=1, recordings=12, seconds=10.0).write(folder / "robots")
    (folder / "spec.toml").write_text(SPEC)
    return folder


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGKILL, -9), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)],
)
@pytest.mark.parametrize("what", ["batch", "table", "volume"])
def test_nobody_is_left_behind(lab, tmp_path, what, number, status):
    (tmp_path / "volume.py").write_text(VOLUME)
    command, processes = {
        "batch": ((*ARMDYN, "batch", str(lab / "spec.toml"), "--output", "out", "--workers", "2"), 5),
        "table": ((*ARMDYN, "table", "--seeds", "3", "--out", "out"), 2),
        "volume": ((sys.executable, "volume.py", str(tmp_path / "v.zarr")), 4),
    }[what]
    if what == "volume" and number != signal.SIGKILL:
        pytest.skip("a function: signals are those of whoever calls it")
    with marked(*command, cwd=tmp_path, stderr=subprocess.DEVNULL) as (process, mark):
        assert becomes(lambda: len(of_mark(mark)) >= processes or process.poll() is not None)
        process.send_signal(number)
        assert process.wait(PATIENCE) == status
        assert becomes(lambda: not of_mark(mark))
