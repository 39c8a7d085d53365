"""A real master, a real rosbridge, the twin and the trial, each in its process, in real time."""

import numpy as np
import pytest
from ros_wire.wire import Stalls, TracedTwin, Trial, Wire, missing

import urdf
from armdyn.run import read_run
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS

pytestmark = pytest.mark.skipif(missing() is not None, reason=str(missing()))

TRIES = 3
"""Runs in real time that a machine may spoil by standing still before it is left out."""
STOOD_STILL = 0.02
"""A machine that keeps a real-time thread from running for so long [s] is not a place for commands at 100 Hz."""
TIMING = ("too old", "stood still", "paused", "no command for", "watchdog", "no sample arrives")
"""What a run says that ended because the machine was too slow."""


@pytest.fixture
def wire():
    with Wire() as started:
        yield started


def run(wire, folder, *options, seed=0):
    """A trial on a twin; repeated where it failed because this machine demonstrably stood still."""
    for attempt in range(TRIES):
        here = folder / str(attempt)
        here.mkdir()
        stalls = Stalls()
        with TracedTwin(wire, here, seed) as twin, Trial(wire, twin, here, *options) as trial:
            status, said, answer = trial.wait()
            stalls.close()
            trace = twin.end()
        spoiled = status == 1 and any(words in said for words in TIMING) and stalls.worst > STOOD_STILL
        if not spoiled:
            return status, said, answer, trace, trial
    pytest.skip(f"this machine stood still for {1e3 * stalls.worst:.0f} ms: no place for a run in real time")


def test_the_load_lands_in_the_box_over_ros(wire, tmp_path):
    status, said, answer, trace, trial = run(wire, tmp_path, "--length-guess", "0.448")
    assert status == 0, said
    assert trace["load_in_box"]
    assert abs(answer["length_estimate"] - 0.368) < 0.001
    assert answer["length_true"] is None
    assert trace["ignored"] == 0
    q, limits = trace["positions"], urdf.load("baxter").limits
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert np.all(np.abs(np.diff(q, n=order, axis=0)) / CONTROL_PERIOD_SECONDS**order <= 1.001 * bound + 1e-6)
    recorded = read_run(trial.out / "trial.mcap")
    assert len(recorded.channels["load_force"]) > 600
    assert (trial.out / "report.html").is_file()


@pytest.mark.slow
def test_a_rehearsal_needs_no_load_cell(wire, tmp_path):
    with TracedTwin(wire, tmp_path) as twin, Trial(wire, twin, tmp_path, "--rehearse") as trial:
        status, said, answer = trial.wait()
        trace = twin.end()
    assert status == 0, said
    assert answer["tracking_error"] < 0.05
    assert np.max(np.abs(np.diff(trace["positions"], axis=0))) / CONTROL_PERIOD_SECONDS < 0.4
