"""The robot finds out by itself what its model lacks; the plant is MuJoCo's and shares no code with the models."""

from types import SimpleNamespace

import numpy as np
import pytest

from armdyn.errors import InputError, TaskFailedError
from armdyn.experiments.separation import TIE_CHI2
from pipeline.motion import LineTrajectory
from pipeline.nodes.scheduler import Watchdog
from pipeline.report.page import write_page
from pipeline.trial import ProtocolSettings, TrialSettings, simulate_trial
from pipeline.trial.ending import TrialEnding
from pipeline.trial.investigation import (
    MIN_EXPECTED_CHI2_INCREASE,
    InvestigationEndReason,
    early_ending,
    investigate,
)


@pytest.mark.slow  # two experiments, their diagnoses and a design: half a minute
@pytest.mark.parametrize(("hidden", "seed"), [("pivot_viscous_friction", 2), ("quadratic_drag", 1), ("linear_drag", 1)])
def test_effects_that_tie_at_first_are_told_apart(hidden, seed, tmp_path):
    settings = TrialSettings(hidden={hidden: None}, seed=seed, investigate=4, out=tmp_path)
    trial = simulate_trial(settings)
    found = trial.result.investigation
    assert found is not None
    assert len(found.stages[0].candidates) > 1  # a tie
    assert found.stop is InvestigationEndReason.NAMED
    assert found.stages[-1].candidates == (hidden,)
    # How many experiments it takes, and how often the load lands then: benchmarks/investigations.py.
    answer = trial.result.as_json()["investigation"]
    # In between one may be named that is not surely better than its rivals: the robot goes on.
    assert (answer[0]["verdict"], answer[-1]["verdict"]) == ("cannot_tell_apart", "effect_missing")
    assert answer[0]["experiment"] is None
    # With five candidates one motion rarely leaves one; it must tell at least one pair apart.
    assert found.stages[1].proposal.expected.chi2_increase.max() > MIN_EXPECTED_CHI2_INCREASE
    assert answer[-1]["belief"][hidden] > 1.0 / (1.0 + np.exp(-TIE_CHI2 / 2.0))
    assert (tmp_path / "experiment_1.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("hidden", "size", "seed"), [("string_creep", 5e-4, 601), ("sensor_lag", 0.02, 431)])
def test_what_the_first_motion_hides_is_found_by_one_that_is_made_to_show_it(hidden, size, seed):
    trial = simulate_trial(TrialSettings(hidden={hidden: size}, seed=seed, investigate=3))
    first, *_, last = trial.result.investigation.stages
    assert first.candidates == ()
    assert hidden in {limit.parameter.effect for limit in first.limits}
    assert last.candidates == (hidden,)
    assert trial.result.success  # a string that grew for 40 s is as long as the model says


@pytest.mark.slow
def test_where_nothing_is_missing_it_is_said_what_would_be_too_small_to_show():
    trial = simulate_trial(TrialSettings(seed=431, investigate=3))
    found = trial.result.investigation
    assert found.stop is InvestigationEndReason.EXPLAINED
    assert "too small to show would be" in found.sentence
    first, *_, last = found.stages
    assert len(found.stages) == 2
    assert len(last.limits) < len(first.limits)
    told = trial.result.as_json()["investigation"][-1]["too_small_to_show"]
    assert {one["parameter"] for one in told} == {limit.parameter.name for limit in last.limits}


@pytest.mark.slow
def test_what_no_motion_separates_is_said_and_the_load_lands_all_the_same():
    trial = simulate_trial(TrialSettings(hidden={"wind": 0.03}, seed=1, investigate=4))
    found = trial.result.investigation
    assert found.stop is InvestigationEndReason.INSEPARABLE
    assert set(found.stages[-1].candidates) == {"wind", "path_tilt"}
    assert found.remedy is not None
    assert "turned round" in found.sentence
    assert trial.result.success


class Asleep(Watchdog):
    """Stops nothing: how busy this machine is does not matter here."""

    def _watch(self):
        pass


@pytest.mark.slow
def test_on_a_real_clock_the_arm_stands_while_the_recordings_are_thought_over(monkeypatch):
    """Plans are made ahead and beside the loop, as on a robot; time is simulated, so that nothing is late."""
    monkeypatch.setattr("pipeline.trial.experiment.Watchdog", Asleep)
    trial = simulate_trial(TrialSettings(hidden={"pivot_viscous_friction": None}, seed=2, investigate=3), real=True)
    found = trial.result.investigation
    assert found is not None
    assert found.stop is InvestigationEndReason.NAMED
    assert found.stages[-1].candidates == ("pivot_viscous_friction",)
    assert trial.result.success


def test_an_experiment_that_is_stopped_ends_the_investigation(baxter, table, complains):
    ending = TrialEnding(False, "the string went slack", True)
    stopped = SimpleNamespace(drive=SimpleNamespace(state=SimpleNamespace(s=0.01)), interrupted=15)

    def investigated(most):
        settings = ProtocolSettings(investigate=most)
        return investigate(settings, lambda *_: (stopped, ending), baxter, table, lambda _: None)

    found = investigated(4)
    assert found.stop is InvestigationEndReason.INTERRUPTED
    assert found.ending is ending
    assert found.stages == ()
    trial = SimpleNamespace(interrupted=None)
    assert early_ending(trial, found) is ending
    assert trial.interrupted == 15
    assert early_ending(trial, None) is None
    with complains(InputError):
        investigated(0)


def test_a_motion_at_another_rate_than_the_robots_is_refused(complains):
    time = np.arange(0.0, 4.0, 0.02)
    still = np.zeros(len(time))
    with complains(InputError):
        ProtocolSettings(motion=LineTrajectory(time, still, still, still))


@pytest.mark.parametrize("options", [("--investigate", "-1"), ("--investigate", "2", "--no-estimation")])
def test_options_that_make_no_sense_are_refused(refused, options, complains):
    complains.line(refused("trial", *options))


def test_a_trial_whose_first_experiment_was_stopped_has_a_report(monkeypatch, tmp_path):
    def held(_self):
        raise TaskFailedError("somebody holds the arm")

    monkeypatch.setattr("pipeline.trial.investigation.SwingExperiment._learn", held)
    trial = simulate_trial(TrialSettings(investigate=2))
    assert not trial.result.success
    assert trial.result.investigation.stop is InvestigationEndReason.INTERRUPTED
    write_page(trial.report(), tmp_path / "report.html")
    assert "Somebody holds the arm" in (tmp_path / "report.html").read_text()
