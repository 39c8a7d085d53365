"""The page that a reader clicks through: every step, run and joint, with the same errors as the answer's."""

import base64

import numpy as np
import pytest
from browser import Browser
from worlds.baxter import JOINTS, generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.recording.preparation import Preparation, combined_preparations, preparation_sentence
from pipeline.answers import signal_preparation_json
from pipeline.report.overlay import (
    EXAM_RUN,
    FITTED_RUN,
    HELD_OUT_RUN,
    OverlayFigure,
    SignalOverlay,
    last_step_curve_data,
    prediction_quality,
    quantised,
    training_overlays,
)
from pipeline.report.page import page_html
from pipeline.report.repair import comparison_report, diagnosis_report, repair_report
from pipeline.report.theme import MAX_PLOTTED_POINTS, thinned_signal

HIDDEN = "joint_viscous_friction"


@pytest.fixture(scope="module")
def study():
    runs = [generate(HIDDEN, 1.0, 0, rate=100.0, recording=i) for i in range(3)]
    catalogue = [CATALOGUE[name] for name in (HIDDEN, "torque_offset")]
    return make_study(arm_model(robot="baxter"), runs[:1], runs[1:2], catalogue, runs[2:])


@pytest.fixture(scope="module")
def found(study):
    return repair(study)


@pytest.fixture(scope="module")
def reports(study, found):
    return {
        "compare": comparison_report(study, compare(study)),
        "diagnose": diagnosis_report(study, diagnose(study)),
        "repair": repair_report(study, found),
    }


@pytest.fixture(scope="module")
def shown(study, found):
    return OverlayFigure.of_study(study, [step.fit for step in found.steps], ["a step"] * len(found.steps), ())


def test_every_run_joint_and_step_has_the_error_of_the_path(found, shown, reports):
    totals = shown.totals()
    (widget,) = [section.widget for section in reports["repair"].sections if section.widget is not None]
    assert widget.data["totals"] == totals
    for i, step in enumerate(found.path):
        for kind, errors in ((FITTED_RUN, step.rmse), (HELD_OUT_RUN, step.held_out_rmse), (EXAM_RUN, step.exam_rmse)):
            shares = {channel: by_step[i][0] for channel, by_step in totals[kind].items()}
            assert shares == pytest.approx(errors)
            assert list(shares) == [f"tau.{joint}" for joint in JOINTS]
    as_given, last = (prediction_quality([c for c in shown.curves if c.kind == EXAM_RUN], step) for step in (0, -1))
    assert last.rmse < 0.3 * as_given.rmse  # the friction explains what the model as given did not
    assert as_given.explained < last.explained < 1.0


def test_error_and_share_are_those_of_their_definition():
    rng = np.random.default_rng(0)
    time = np.arange(50.0)
    curves = [
        SignalOverlay(
            "a", FITTED_RUN, f"tau.{i}", "N m", time, rng.normal(3.0, 2.0, 50), rng.normal(0.0, 0.5, (1, 50)), 0.1
        )
        for i in range(2)
    ]
    left = sum(np.mean(c.residuals[0] ** 2) for c in curves)
    explained = 1.0 - left / sum(np.var(c.measured) for c in curves)
    assert prediction_quality(curves, 0) == pytest.approx((np.sqrt(left), explained))


def test_quantised_values_are_finer_than_a_screen_and_a_long_curve_is_thinned():
    values = np.random.default_rng(1).normal(1e3, 2.0, 500)
    low, step, text = quantised(values)
    back = low + step * np.frombuffer(base64.b64decode(text), "<u2")
    assert np.abs(back - values).max() <= 0.5001 * np.ptp(values) / 65535
    assert quantised(np.full(3, 2.0))[:2] == [2.0, 1.0]
    time = np.arange(10_000.0)
    long = SignalOverlay("a", FITTED_RUN, "tau.a", "N m", time, np.sin(time), np.zeros((1, len(time))), 0.1)
    assert len(base64.b64decode(last_step_curve_data(long, 100)["residual"][2])) == 2 * 100


def test_the_pages_first_numbers_are_explained_torque_and_error_in_newton_metres(found, reports):
    misfit, *figures = reports["repair"].key_figures
    assert misfit.name == "Misfit explained"
    assert f"explains {misfit.value} of the misfit" in found.sentence.replace("they explain ", "it explains ")
    assert [(figure.name, figure.value.split()[-1]) for figure in figures] == [
        ("Torque explained", "%"), ("Torque error", "m"),
    ]  # fmt: skip
    assert all("as given" in figure.note and "exam" in figure.note for figure in figures)


def test_a_diagnosis_shows_what_its_effects_would_change(reports):
    evidence, _, overlay = reports["diagnose"].sections[:3]
    columns = {column.name: column for column in evidence.tables[0].columns}
    assert columns["effect"].values[0] == HIDDEN
    assert 0.0 < columns["error"].bar_lengths[0] < 1.0
    assert len(overlay.widget.data["steps"]) > 1


@pytest.mark.parametrize("name", ["compare", "diagnose", "repair"])
def test_the_first_picture_is_the_missing_force(reports, name):
    answer, first = reports[name].sections[:2]
    assert answer.title == "Which effect is missing" if name == "diagnose" else "Parameters"
    assert not answer.charts
    assert first.title == "The missing force"
    assert set(first.tabs) == {f"tau.{joint}" for joint in JOINTS}
    for chart in first.charts:
        layout = chart.figure["layout"]
        titles = [layout[f"xaxis{i}"]["title"]["text"] for i in ("", 2, 3, 4, 5)]
        assert (titles[0], titles[-1]) == ("speed<br>[rad/s]", "time<br>[s]")
        assert layout["yaxis"]["title"]["text"] == "missing torque [N m]"
        assert f"of {chart.tab.removeprefix('tau.')} grows in proportion to the speed, by " in chart.caption
        legend = [t["name"] for t in chart.figure["data"] if t["showlegend"] and "name" in t]
        assert (
            legend
            == {
                "compare": ["as given"],
                "diagnose": ["as given", "with what is missing"],
                "repair": ["as given", "repaired"],
            }[name]
        )
    page = page_html(reports[name])
    assert page.index("The missing force") < page.index("Measured and predicted")
    assert len(page) < 3_000_000


def test_of_each_joint_the_first_residual_is_that_against_its_own_velocity(reports):
    for report in reports.values():
        charts = report.section("What the residual depends on").charts
        first = {chart.tab: chart for chart in reversed(charts)}
        for joint in JOINTS:
            title = first[f"tau.{joint}"].figure.layout.xaxis.title.text
            assert title == f"velocity of {joint} [rad/s]"


def test_the_page_and_the_answer_have_one_noise(found, reports):
    (table,) = reports["repair"].section("Errors").tables
    columns = {column.heading: column.values for column in table.columns}
    assert columns["channel"] == [f"torque of {joint}" for joint in JOINTS]
    assert columns["noise std"] == [channel.noise_std for channel in found.after.channels.values()]
    total = np.sqrt(sum(channel.noise_std**2 for channel in found.after.channels.values()))
    assert reports["repair"].key_figures[-1].note.endswith(f"noise {total:.3g} N m")


def test_where_a_model_fails_is_said_in_words_before_what_the_residual_depends_on(reports):
    titles = [section.title for section in reports["compare"].sections]
    assert titles.index("Where the model fails") < titles.index("What the residual depends on")
    (table,) = reports["compare"].section("Where the model fails").tables
    columns = {column.heading: column.texts for column in table.columns}
    assert {text.partition(" of ")[0] for text in columns["channel"]} == {"torque"}
    assert f"velocity of {columns['channel'][0].partition(' of ')[2]}" in columns["where"]
    assert table.caption


def test_a_browser_shows_the_chosen_joint_run_and_step(found, reports, shown, tmp_path):
    """What stands there after the page's script has run: the line above the curves, and the chosen tab."""
    page = tmp_path / "repair.html"
    page.write_text(page_html(reports["repair"]))
    curve = next(c for c in shown.curves if c.channel == "tau.right_e1" and c.kind == FITTED_RUN)
    with Browser() as tab:
        tab.go(f"{page.as_uri()}#tab=tau.right_e1&step=0&run=0")
        tab.wait("document.body.dataset.ready")
        text = " ".join(tab.ask("document.querySelector('.readout').innerText").split())
        assert text.startswith("torque of right_e1")
        assert text.endswith(
            f"error {prediction_quality([curve], 0).rmse:.3g} N m"
        )  # and no "as given": this is the model as given
        curves = "document.querySelector('.widget .chart')._fullData"
        bands = tab.ask(f"{curves}.filter((trace) => trace.fill === 'toself').map((trace) => trace.fillcolor)")
        assert len(bands) == len(set(bands)) == 1  # of the model as given there is only that of the noise
        tab.click(f"[data-control=step][value='{len(found.path) - 1}']")
        bands = tab.ask(f"{curves}.filter((trace) => trace.fill === 'toself').map((trace) => trace.fillcolor)")
        assert len(bands) == len(set(bands)) == 2
        low, high = tab.ask("document.querySelector('.widget .chart')._fullLayout.yaxis2.range")
        assert high - low < np.ptp(curve.residuals[0])  # the axis is that of the chosen step, not of the model as given
        # The curves, and what the residual of this joint depends on.
        assert tab.ask("document.querySelectorAll('.plot-container').length") >= 2
        assert tab.errors == []


def test_what_was_done_to_measured_torques_is_shown_said_and_answered():
    fit = make_study(arm_model(robot="baxter"), [generate(None, 1.0, 0, rate=250.0)], [], []).first()
    run, answer = fit.problem.runs[0].original, signal_preparation_json(fit.problem)
    assert list(answer) == [block.channel for block in fit.blocks]
    for curve, block in zip(training_overlays([fit]), fit.blocks, strict=True):
        raw = run.channels[block.channel]
        time, value = thinned_signal(curve.recorded.time, curve.recorded.value)
        assert len(curve.time) < len(time) <= MAX_PLOTTED_POINTS + 1
        assert (value.min(), value.max()) == (raw.value.min(), raw.value.max())
        assert (time[0], time[-1]) == pytest.approx((raw.time[0], raw.time[-1]), abs=0.05)
        assert np.all(np.diff(time) > 0.0)
        assert f"{len(curve.time)} samples, 17.9 per second, of {len(raw)} recorded" in curve.note
        done = answer[block.channel]
        assert (done["cutoff_hz"], done["rate_hz"]) == (pytest.approx(10.0), pytest.approx(17.92))
        assert (done["samples"], done["recorded"]) == (len(block.residual), 3750)
    done = preparation_sentence(combined_preparations(run.preparations for run in fit.problem.runs))
    said = OverlayFigure(training_overlays([fit]), preparation=done).section().sentence
    assert "compared below 10 Hz" in said
    assert "17.9 samples per second of 250" in said


def test_of_several_runs_the_narrowest_band_counts_and_a_joint_that_hardly_moves_is_told():
    wide = Preparation(10.0, 3.0, 18.0, 180, 100.0, 1000, 0.0, 1.0)
    narrow = Preparation(4.0, 2.0, 7.0, 70, 100.0, 1000, 0.02, 0.5)
    (both,) = combined_preparations([{"tau.a": wide}, {"tau.a": narrow}]).values()
    assert both == Preparation(4.0, 2.0, 7.0, 250, 100.0, 2000, 0.01, 0.75)
    said = preparation_sentence({"tau.a": wide, "tau.b": narrow})
    assert "below 4 to 10 Hz (positions are motion below 2 to 3 Hz, noise above): 7 to 18 samples per second" in said
    assert "1 % are left out" in said
    assert preparation_sentence({}) == ""
    rests = Preparation(10.0, 3.0, 18.0, 180, 100.0, 1000, 0.0, 0.004)
    assert " b hardly moves" in preparation_sentence({"tau.a": wide, "tau.b": rests})
    assert "hardly" not in preparation_sentence({"tau.a": wide})
