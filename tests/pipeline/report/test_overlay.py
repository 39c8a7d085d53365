"""The page that a reader clicks through: every step, run and joint, with the same errors as the answer's."""

import base64
import html
import re
import shutil
import subprocess

import numpy as np
import pytest
from hidden_effects.arm import JOINTS, generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import repair
from armdyn.identify.study import Study
from pipeline.report.overlay import EXAM, FITTED, HELD_OUT, Overlay, Overlays, quality, quantised
from pipeline.report.page import page_html, write_page
from pipeline.report.repair import comparison_report, diagnosis_report, repair_report

HIDDEN = "joint_viscous_friction"
EFFECTS = [HIDDEN, "torque_offset"]


@pytest.fixture(scope="module")
def study():
    runs = [generate("joint_viscous_friction", 1.0, 0, rate=100.0, recording=i) for i in range(3)]
    catalogue = [CATALOGUE[name] for name in EFFECTS]
    return Study(arm_model(robot="baxter"), runs[:1], runs[1:2], catalogue, runs[2:])


@pytest.fixture(scope="module")
def found(study):
    return repair(study)


@pytest.fixture(scope="module")
def shown(study, found):
    return Overlays.of_study(study, [step.fit for step in found.steps], ["a step"] * len(found.steps), ())


@pytest.fixture(scope="module")
def page(study, found, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "repair.html"
    write_page(repair_report(study, found), path)
    return path


def test_every_run_joint_and_step_has_the_error_of_the_path(study, found, shown):
    totals = shown.totals()
    widgets = [section.widget for section in repair_report(study, found).sections if section.widget is not None]
    assert widgets[0].data["totals"] == totals
    for i, step in enumerate(found.path):
        for kind, errors in ((FITTED, step.rmse), (HELD_OUT, step.held_out_rmse), (EXAM, step.exam_rmse)):
            shares = {channel: by_step[i][0] for channel, by_step in totals[kind].items()}
            assert shares == pytest.approx(errors)
            assert list(shares) == [f"tau.{joint}" for joint in JOINTS]


def test_the_friction_explains_what_the_model_as_given_did_not(found, shown):
    as_given, last = (quality([c for c in shown.curves if c.kind == EXAM], step) for step in (0, -1))
    assert len(found.steps) > 1
    assert last.rmse < 0.3 * as_given.rmse
    assert as_given.explained < last.explained < 1.0


def test_error_and_share_are_those_of_their_definition():
    rng = np.random.default_rng(0)
    time = np.arange(50.0)
    curves = [
        Overlay("a", FITTED, f"tau.{i}", "N m", time, rng.normal(3.0, 2.0, 50), rng.normal(0.0, 0.5, (1, 50)), 0.1)
        for i in range(2)
    ]
    of_both = quality(curves, 0)
    left = sum(np.mean(c.residuals[0] ** 2) for c in curves)
    assert of_both.rmse == pytest.approx(np.sqrt(left))
    assert of_both.explained == pytest.approx(1.0 - left / sum(np.var(c.measured) for c in curves))


def test_quantised_values_are_finer_than_a_screen():
    values = np.random.default_rng(1).normal(1e3, 2.0, 500)
    low, step, text = quantised(values)
    back = low + step * np.frombuffer(base64.b64decode(text), "<u2")
    assert np.abs(back - values).max() <= 0.5001 * np.ptp(values) / 65535
    assert quantised(np.full(3, 2.0))[:2] == [2.0, 1.0]


def test_the_page_is_small(page):
    assert page.stat().st_size < 3_000_000


def test_the_pages_first_numbers_are_explained_torque_and_error_in_newton_metres(study, found):
    misfit, *figures = repair_report(study, found).key_figures
    assert misfit.name == "Misfit explained"
    assert f"explains {misfit.value} of the misfit" in found.sentence.replace("they explain ", "it explains ")
    assert [figure.name for figure in figures] == ["Torque explained", "Torque error"]
    assert figures[0].value.endswith("%")
    assert figures[1].value.endswith("N m")
    assert all("as given" in figure.note and "exam" in figure.note for figure in figures)


def test_a_diagnosis_shows_what_its_effects_would_change_and_folds_the_evidence(study):
    report = diagnosis_report(study, diagnose(study))
    overlay, evidence = report.sections[1:3]
    (candidates,) = evidence.tables
    columns = {column.name: column for column in candidates.columns}
    assert columns["effect"].values[0] == "joint_viscous_friction"
    assert 0.0 < columns["error"].shares[0] < 1.0
    assert len(overlay.widget.data["steps"]) > 1


def seen(page, choice):
    """What a browser shows after its script has run: the line above the curves, and the chosen tab."""
    browser = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs Chromium")
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"]
    dom = subprocess.run(
        [browser, *flags, f"{page.as_uri()}#{choice}"], capture_output=True, text=True, timeout=120, check=True
    ).stdout
    assert 'data-ready="yes"' in dom
    readout = re.search(r'<p class="readout"[^>]*>(.*?)</p>', dom)[1]
    return html.unescape(" ".join(re.sub("<[^>]+>", " ", readout).split())), dom


def test_a_browser_shows_the_chosen_joint_run_and_step(page, shown):
    text, dom = seen(page, "tab=tau.right_e1&step=0&run=0")
    curve = next(c for c in shown.curves if c.channel == "tau.right_e1" and c.kind == FITTED)
    assert text.startswith("torque of right_e1")
    assert text.endswith(f"error {quality([curve], 0).rmse:.3g} N m")  # and no "as given": this is the model as given
    assert dom.count("plot-container") >= 2  # the curves, and what the residual of this joint depends on


@pytest.mark.parametrize("name", ["compare", "diagnose", "repair"])
def test_the_first_picture_is_the_missing_force(study, found, name):
    made = {
        "compare": lambda: comparison_report(study, compare(study)),
        "diagnose": lambda: diagnosis_report(study, diagnose(study)),
        "repair": lambda: repair_report(study, found),
    }[name]()
    first = made.sections[0]
    assert first.title == "The missing force"
    assert set(first.tabs) == {f"tau.{joint}" for joint in JOINTS}
    for chart in first.charts:
        layout = chart.figure["layout"]
        titles = [layout[f"xaxis{i}"]["title"]["text"] for i in ("", 2, 3, 4, 5)]
        assert titles[0] == "speed [rad/s]"
        assert titles[-1] == "time [s]"
        assert layout["yaxis"]["title"]["text"] == "missing torque [N m]"
        assert f"of {chart.tab.removeprefix('tau.')} grows in proportion to the speed, by " in chart.caption
        legend = [t["name"] for t in chart.figure["data"] if t["showlegend"] and "name" in t]
        assert legend == ["as given"] if name == "compare" else legend[0] == "as given" and HIDDEN in legend[1]
    assert page_html(made).index("The missing force") < page_html(made).index("Measured and predicted")
