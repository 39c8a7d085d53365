from dataclasses import replace

import numpy as np
import pytest
from simulated_truth import gripper_truth

from armdyn.run import read_run
from pipeline.box import Box
from pipeline.motion.transitions import minimum_jerk
from pipeline.nodes.task import TaskSettings
from pipeline.report.page import write_page
from pipeline.robot.settings import PlantSettings
from pipeline.trial import TrialSettings, simulate_trial


def test_a_wrong_guess_is_corrected_and_the_load_lands(learnt, off_target):
    result = learnt.result
    assert result.success
    assert result.feasible
    assert off_target(learnt) < 0.04  # 0.020 to 0.023 on three seeds
    assert abs(result.length_estimate - 0.368) < 2e-3  # one standard deviation is 0.3 mm
    assert result.estimates[-1].std < 1e-3
    assert result.minimum_tension > 0.1  # 0.30
    assert result.peak["x"] < 0.2  # 0.08


def test_the_recording_is_a_run_of_a_hanging_load(learnt):
    result, task = learnt.result, learnt.experiment.task
    run = read_run(result.recording)
    csv = read_run(result.recording.with_suffix(".csv"))
    assert set(csv.channels) == set(run.channels)
    force = run.channels["load_force"]
    swing_end = task.swing_start + task.settings.duration
    assert force.time[-1] < swing_end + 0.1  # what came after the load was let down is kept elsewhere
    assert force.value.min() > 0.0
    assert run.known["mass"].value == pytest.approx(0.08)


def test_the_report_is_one_file_that_tells_the_verdict_and_what_to_do(learnt, tmp_path):
    write_page(learnt.report(), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "load came to rest in the box" in page
    assert "The box is not the paper" in page
    assert learnt.report().next_steps == ()
    missed = replace(learnt, result=replace(learnt.result, success=False))
    repair, again = missed.report().next_steps
    folder = learnt.result.recording.parent
    assert repair.command.startswith(f"armdyn repair {folder / 'model.toml'} {folder / 'trial.csv'}")
    assert again.command == "armdyn trial --model repaired.toml"


# Off by 0.26, 0.24 and 0.27 m, to 4 mm on six seeds; a guess of 0.408 m is 0.14 m off and left to `armdyn table`.
MISSES = [(0.308, False), *(pytest.param(guess, False, marks=pytest.mark.slow) for guess in (0.348, 0.428))]


@pytest.mark.parametrize(("guess", "lands"), [(0.368, True), *MISSES])
def test_without_estimation_only_a_right_guess_lands(guess, lands, off_target):
    trial = simulate_trial(TrialSettings(length_guess=guess, estimate=False, seed=2))
    assert trial.result.success == lands
    assert off_target(trial) < 0.04 if lands else off_target(trial) > 0.15  # 0.014 to 0.017 on six seeds


@pytest.mark.parametrize("guess", [0.15, pytest.param(0.9, marks=pytest.mark.slow)])
def test_estimation_converges_from_far_away(guess, off_target):
    trial = simulate_trial(TrialSettings(length_guess=guess, seed=4))
    assert abs(trial.result.length_estimate - 0.368) < 2e-3  # 0.6 mm at most on eight seeds
    assert trial.result.success
    assert off_target(trial) < 0.04  # 0.018 to 0.023


def test_a_slack_string_stops_the_swing():
    # The load bumps against a wall that is too near: slack for 0.15 s, 0.05 s is enough, 0.25 s before the end.
    plant = PlantSettings(box=Box(near_wall=0.28))
    trial = simulate_trial(TrialSettings(length_guess=0.368, estimate=False, seed=2, plant=plant))
    assert "slack" in trial.result.message
    assert trial.experiment.drive.at_rest
    assert abs(gripper_truth(trial.robot).s_velocity) < 0.02  # m/s; 0.005 at most, the arm still gives a little


def test_an_infeasible_plan_never_moves_the_arm():
    far = TaskSettings(target_x=1.5, travel_weight=0.0)
    trial = simulate_trial(TrialSettings(length_guess=0.368, estimate=False, task=far))
    result = trial.result
    assert not result.success
    assert result.stopped
    assert trial.experiment.task.swing_start is None
    assert np.abs(trial.experiment.channel("reference.x").value).max() == 0.0


def test_a_motion_is_checked_where_it_runs_not_where_its_file_says(armdyn, tmp_path):
    """From -0.28 m the joints can follow, from where the arm stands they cannot: nothing moves."""
    u = np.arange(71) / 70
    share, speed, acceleration = (0.38 * x for x in minimum_jerk(u, 0.7))
    columns = (0.7 * u, share - 0.28, speed, acceleration)
    rows = "\n".join(",".join(f"{x:.12g}" for x in row) for row in zip(*columns, strict=True))
    (tmp_path / "motion.csv").write_text(f"time [s],s [m],v [m/s],a [m/s^2]\n{rows}\n")
    assert armdyn("check", "motion.csv", "--robot", "baxter")[0] == 0
    status, _, err = armdyn("trial", "--motion", "motion.csv", "--out", "out")
    assert status == 1
    assert "the motion, from where the arm stands," in err
