"""What was done to measured torques is said and shown."""

import numpy as np
import pytest
from hidden_effects.arm import generate

from armdyn.arm.model import arm_model
from armdyn.identify.study import Study
from armdyn.preparation import Preparation, of_all_runs, sentence
from pipeline.answers import preparation_answer
from pipeline.report.overlay import Overlays, of_fits
from pipeline.report.theme import MOST_POINTS, thinned


@pytest.fixture(scope="module")
def fit():
    return Study(arm_model(robot="baxter"), [generate(None, 1.0, 0, rate=250.0)], [], []).first()


def test_the_recording_is_shown_at_its_full_rate_behind_what_is_compared(fit):
    run = fit.problem.runs[0].original
    for curve, block in zip(of_fits([fit]), fit.blocks, strict=True):
        raw = run.channels[block.channel]
        time, value = thinned(curve.recorded)
        assert len(curve.time) < len(time) <= MOST_POINTS + 1
        assert (value.min(), value.max()) == (raw.value.min(), raw.value.max())
        assert (time[0], time[-1]) == pytest.approx((raw.time[0], raw.time[-1]), abs=0.05)
        assert np.all(np.diff(time) > 0.0)
        assert f"{len(curve.time)} samples, 17.9 per second, of {len(raw)} recorded" in curve.note


def test_band_and_rate_are_said(fit):
    done = sentence(of_all_runs(run.preparations for run in fit.problem.runs))
    section = Overlays(of_fits([fit]), preparation=done).section()
    assert "compared below 10 Hz" in section.sentence
    assert "17.9 samples per second of 250" in section.sentence


def test_the_answer_holds_what_was_done_to_every_channel(fit):
    answer = preparation_answer(fit.problem)
    assert list(answer) == [block.channel for block in fit.blocks]
    for block in fit.blocks:
        done = answer[block.channel]
        assert (done["cutoff_hz"], done["rate_hz"]) == (pytest.approx(10.0), pytest.approx(17.92))
        assert (done["samples"], done["recorded"]) == (len(block.residual), 3750)


def test_of_several_runs_the_narrowest_band_counts():
    wide, narrow = (
        Preparation(10.0, 3.0, 18.0, 180, 100.0, 1000, 0.0, 1.0),
        Preparation(4.0, 2.0, 7.0, 70, 100.0, 1000, 0.02, 0.5),
    )
    (both,) = of_all_runs([{"tau.a": wide}, {"tau.a": narrow}]).values()
    assert both == Preparation(4.0, 2.0, 7.0, 250, 100.0, 2000, 0.01, 0.75)
    assert sentence({"tau.a": wide, "tau.b": narrow}) == (
        "Torques are compared below 4 to 10 Hz (positions are motion below 2 to 3 Hz, noise above): 7 to 18 samples "
        "per second of 100 hold all of that; 1 % are left out where a joint turns round or rests."
    )
    assert sentence({}) == ""


def test_a_joint_that_hardly_moves_is_told():
    moves, rests = (Preparation(10.0, 3.0, 18.0, 180, 100.0, 1000, 0.0, share) for share in (1.0, 0.004))
    told = "hardly moves: these runs show no friction or rotor inertia there."
    assert sentence({"tau.a": moves, "tau.b": rests}).endswith(f" b {told}")
    assert "hardly" not in sentence({"tau.a": moves})
