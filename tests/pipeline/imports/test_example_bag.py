"""A real bag of ROS 1, recorded with real tools from the kit's robot; skipped where the kit is missing."""

import os
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from armdyn.run import read_run, write_run_csv
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import map_unambiguous_columns

pytest.importorskip("rosbags", reason="bags need rosbags: pip install 'armdyn[ros]'")
BAG = Path(os.environ.get("ARMDYN_ROS_KIT", "")) / "example.bag"
pytestmark = pytest.mark.skipif(not BAG.is_file(), reason="no ROS kit: its folder goes into ARMDYN_ROS_KIT")
ARM = tuple(f"right_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2"))


def test_a_real_bag_becomes_a_run_of_both_arms(tmp_path):
    (foreign,) = read_foreign(BAG)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    assert set(ARM) < set(run.joints)
    assert len(run.joints) == 17
    q = run.channels["q.right_s1"]
    assert (q.time[0], q.time[-1]) == (pytest.approx(0.0, abs=0.05), pytest.approx(8.8, abs=0.1))
    assert np.median(np.diff(q.time)) == pytest.approx(0.01, rel=0.05)
    assert run.recorded is not None
    assert datetime(2020, 1, 1) < run.recorded < datetime(2100, 1, 1)
    # What was recorded as speed is the slope of what was recorded as position.
    speed = run.channels["v.right_s1"]
    slope = np.gradient(q.value, q.time)
    assert np.median(np.abs(np.interp(speed.time, q.time, slope) - speed.value)) < 0.05
    write_run_csv(run, tmp_path / "run.csv")
    again = read_run(tmp_path / "run.csv")
    assert again.recorded == run.recorded
    np.testing.assert_array_equal(again.channels["tau.right_e1"].value, run.channels["tau.right_e1"].value)
