"""Trials that share a folder, or are killed, leave whole files that belong together."""

import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from time import monotonic, sleep

import pytest
from faults.faulty import AT_REST, Hangs, InRealTime

from armdyn.errors import InputError
from armdyn.run import read_run
from pipeline.nodes.scheduler import Watchdog
from pipeline.trial import TrialSettings, simulate_trial
from pipeline.trial.experiment import Phase
from pipeline.trial.folder import locked_folder, temporary_output_folder


def names(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != ".lock")


def test_what_is_there_stays_until_everything_new_is_there(tmp_path):
    (tmp_path / "trial.mcap").write_text("old")
    (tmp_path / "report.html").write_text("old")
    with temporary_output_folder(tmp_path) as folder:
        (folder / "trial.mcap").write_text("new")
        (folder / "model.toml").write_text("new")
        assert (tmp_path / "trial.mcap").read_text() == "old"
    assert names(tmp_path) == ["model.toml", "trial.mcap"]  # the old report does not belong to the new recording
    assert (tmp_path / "trial.mcap").read_text() == "new"


def test_what_was_written_before_an_exception_is_kept(tmp_path):
    def fails():
        with temporary_output_folder(tmp_path) as folder:
            (folder / "trial.mcap").write_text("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fails()
    assert names(tmp_path) == ["trial.mcap"]


def test_links_and_rights_stay(tmp_path):
    elsewhere, out = tmp_path / "elsewhere.toml", tmp_path / "out"
    out.mkdir()
    elsewhere.write_text("old")
    elsewhere.chmod(0o600)
    (out / "model.toml").symlink_to(elsewhere)
    with temporary_output_folder(out) as folder:
        (folder / "model.toml").write_text("new")
    assert (out / "model.toml").is_symlink()
    assert elsewhere.read_text() == "new"
    assert elsewhere.stat().st_mode & 0o777 == 0o600


def test_a_killed_trial_leaves_the_old_files_and_its_recording(tmp_path):
    (tmp_path / "trial.mcap").write_text("old")
    (tmp_path / "report.html").write_text("old")
    code = (
        "import os, signal, sys; from pathlib import Path; from pipeline.trial.folder import temporary_output_folder\n"
        "with temporary_output_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'trial.mcap').write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert [(tmp_path / name).read_text() for name in ("trial.mcap", "report.html")] == ["old", "old"]
    assert [path.read_text() for path in tmp_path.glob("unfinished-*/trial.mcap")] == ["half"]


def test_a_second_trial_takes_a_folder_of_its_own(tmp_path, complains):
    usual = tmp_path / "out" / "trial"
    with ExitStack() as running:
        taken = [running.enter_context(locked_folder(None, usual)).name for _ in range(3)]
        assert taken == ["trial", "trial-2", "trial-3"]
        with complains(InputError), locked_folder(usual, usual):
            pass
    with locked_folder(None, usual) as folder:
        assert folder == usual


def test_the_folder_of_a_killed_trial_is_free_again(tmp_path):
    code = (
        "import os, signal, sys; from pathlib import Path; from pipeline.trial.folder import locked_folder\n"
        "with locked_folder(Path(sys.argv[1]), Path('x')): os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    with locked_folder(tmp_path, tmp_path) as folder:
        assert folder == tmp_path


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_rights_is_one_line(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="choose another directory"), locked_folder(tmp_path / "out", tmp_path):
        pass


def test_a_file_in_place_of_the_folder_is_one_line(tmp_path, complains):
    (tmp_path / "out").write_text("")
    with complains(InputError), locked_folder(tmp_path / "out", tmp_path):
        pass
    with complains(InputError), temporary_output_folder(tmp_path / "out"):
        pass


def stands(robot, patience=5.0):
    end = monotonic() + patience
    while robot.speed() >= AT_REST and monotonic() < end:
        sleep(0.01)
    return robot.speed() < AT_REST


# A busy machine may delay the loop so much that the trial ends before it hangs, rightly: then it is tried again.
def test_a_watchdog_stops_an_arm_whose_loop_hangs(tmp_path):
    for _ in range(5):
        robot = Hangs(0.7)
        trial = simulate_trial(TrialSettings(estimation_time=2.0, out=tmp_path), through=robot.around, real=True)
        assert stands(robot)
        robot.leave()
        assert trial.result.stopped
        assert len(robot.told[-1]) == 1
        if robot.hung:
            break
    else:
        pytest.skip(f"this machine is too busy for a loop at 100 Hz: {trial.result.message}")
    assert robot.fastest > 0.1
    assert robot.stood_after < 5.0  # it hung until the arm stood
    assert "watchdog stopped the arm" in trial.result.message
    assert read_run(tmp_path / "trial.mcap").channels["gripper_x"].time[-1] > 0.1


class TripsOnce(Watchdog):
    """Stops the arm in one beat of many, as after a hang too short for anything else to notice."""

    rounds = 0

    def _watch(self):
        """Nothing: the wall's clock does not matter here."""

    def report_alive(self):
        self.rounds += 1
        if self.rounds == 60:
            self.fault = "the watchdog stopped the arm"
            self._stop()


def test_what_the_watchdog_stopped_does_not_go_on(monkeypatch):
    """Time is simulated, so that nothing else is late."""
    monkeypatch.setattr("pipeline.trial.experiment.Watchdog", TripsOnce)
    trial = simulate_trial(TrialSettings(estimation_time=5.0), real=True)
    assert trial.result.message == "the watchdog stopped the arm"
    assert trial.experiment.span(Phase.LEARN).end < 1.5


@pytest.mark.slow
def test_a_whole_trial_on_a_real_clock_lands_or_says_why_not(tmp_path):
    for _ in range(3):
        robot = InRealTime()
        trial = simulate_trial(TrialSettings(out=tmp_path), through=robot.around, real=True)
        assert stands(robot)
        robot.leave()
        if not trial.result.stopped:
            break
        assert re.search("stood still|no command for|joints|load cell|busy|watchdog", trial.result.message)
    else:
        pytest.skip(f"this machine is too busy for a loop at 100 Hz: {trial.result.message}")
    assert trial.result.success
    assert abs(trial.result.length_estimate - 0.368) < 2e-3
