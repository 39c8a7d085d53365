"""On a real clock the arm goes on while this program computes, or hangs."""

import re
from time import monotonic, sleep

import pytest
from faults.faulty import AT_REST, Hangs, InRealTime

from armdyn.run import read_run
from pipeline.nodes.scheduler import Watchdog
from pipeline.trial import TrialSettings, simulate
from pipeline.trial.experiment import Phase


def stands(robot, patience=5.0):
    end = monotonic() + patience
    while robot.speed() >= AT_REST and monotonic() < end:
        sleep(0.01)
    return robot.speed() < AT_REST


# A busy machine may delay the loop so much that the trial ends before it hangs, rightly: then it is tried again.
def test_a_watchdog_stops_an_arm_whose_loop_hangs(tmp_path):
    for _ in range(5):
        robot = Hangs(0.7)
        trial = simulate(TrialSettings(estimation_time=2.0, out=tmp_path), through=robot.around, real=True)
        assert stands(robot)
        robot.leave()
        assert trial.result.stopped
        assert len(robot.told[-1]) == 1
        if robot.hung:
            break
    assert robot.fastest > 0.1
    assert robot.stood_after < 5.0  # it hung until the arm stood
    assert "watchdog stopped the arm" in trial.result.message
    assert read_run(tmp_path / "trial.mcap").channels["gripper_x"].time[-1] > 0.1


class TripsOnce(Watchdog):
    """Stops the arm in one beat of many, as after a hang too short for anything else to notice."""

    beats = 0

    def _watch(self):
        """Nothing: the wall's clock does not matter here."""

    def beat(self):
        self.beats += 1
        if self.beats == 60:
            self.fault = "the watchdog stopped the arm"
            self._stop()


def test_what_the_watchdog_stopped_does_not_go_on(monkeypatch):
    """Time is simulated, so that nothing else is late."""
    monkeypatch.setattr("pipeline.trial.experiment.Watchdog", TripsOnce)
    trial = simulate(TrialSettings(estimation_time=5.0), real=True)
    assert trial.result.message == "the watchdog stopped the arm"
    assert trial.experiment.span(Phase.LEARN).end < 1.5


@pytest.mark.slow
def test_a_whole_trial_on_a_real_clock_lands_or_says_why_not(tmp_path):
    for _ in range(3):
        robot = InRealTime()
        trial = simulate(TrialSettings(out=tmp_path), through=robot.around, real=True)
        assert stands(robot)
        robot.leave()
        if not trial.result.stopped:
            break
        assert re.search("stood still|no command for|joints|load cell|busy|watchdog", trial.result.message)
    else:
        pytest.skip(f"this machine is too busy for a loop at 100 Hz: {trial.result.message}")
    assert trial.result.success
    assert abs(trial.result.length_estimate - 0.368) < 2e-3
