"""The picture of an arm's motion shows the run that is most independent of the fit, and how far off the model is."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.arm.closed_loop.rollout import SimulatedPositionError
from armdyn.document import Section
from pipeline.report.motion import motion_charts, with_motion_charts

TIME = np.linspace(0.0, 4.0, 401)


def moved(
    role: str, run: str, joint: str = "elbow", kind: str = "closed_loop", told: bool = True
) -> SimulatedPositionError:
    measured = np.sin(TIME)
    return SimulatedPositionError(
        run, role, kind, joint, "rad", 0.002, 0.001, (0.1, 0.1) if told else None, 0.0,
        TIME, measured, measured + 0.002, measured + 0.1 if told else None,
    )  # fmt: skip


def test_the_most_independent_run_is_drawn_once_for_each_joint():
    found = [moved("training", "a"), moved("held_out", "b"), moved("held_out", "b", "wrist"), moved("training", "c")]
    elbow, wrist = motion_charts(found)
    assert (elbow.tab, wrist.tab) == ("tau.elbow", "tau.wrist")
    assert "elbow in b (held-out)" in elbow.caption
    below = {trace["name"]: trace for trace in elbow.figure["data"] if trace["yaxis"] == "y2"}
    assert below["the model"]["y"] == pytest.approx([0.002] * len(TIME), rel=1e-4)
    assert elbow.figure["layout"]["yaxis2"]["title"]["text"] == "error [rad]"
    assert below["commanded"]["y"] == pytest.approx([0.1] * len(TIME), rel=1e-4)


def test_a_motion_that_runs_away_is_drawn_where_it_goes():
    away = replace(moved("held_out", "b"), simulated=np.sin(TIME) + 2e3 * TIME)
    (chart,) = motion_charts([away])
    *_, last = (trace for trace in chart.figure["data"] if trace["name"] == "the model")
    assert max(last["y"]) == pytest.approx(8e3)
    assert chart.figure["layout"]["meta"]["bulk"]


def test_of_what_pulls_nothing_back_the_longest_windows_are_drawn_without_a_command():
    found = [moved("training", "a", kind=kind, told=False) for kind in ("window_0.5", "window_5")]
    (chart,) = motion_charts(found)
    assert "pieces of 5 s" in chart.caption
    assert {trace["name"] for trace in chart.figure["data"]} == {"measured", "the model"}


def test_a_section_of_the_motion_alone_gets_its_pictures():
    sections = [Section("Parameters"), Section("Motion")]
    parameters, motion = with_motion_charts(sections, [moved("held_out", "b")])
    assert not parameters.charts
    assert motion.tabs == {"tau.elbow": "elbow"}
    assert with_motion_charts(sections, []) == sections
    _, of_servos = with_motion_charts(sections, [moved("held_out", "b")], ["q.elbow"])
    assert of_servos.tabs == {"q.elbow": "elbow"}  # the tab that shows the measured position
