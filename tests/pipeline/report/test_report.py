import base64
import gzip
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import plotly.graph_objects as go
import pytest
from browser import Browser
from plotly.offline import get_plotlyjs
from scipy.stats import binomtest

from armdyn.document import Chart, Column, Document, KeyFigure, NextStep, ResultLevel, Section, Table
from armdyn.errors import InputError
from armdyn.identify.residual.missing_force import ForceCurve
from pipeline.report.feasibility import joint_motion_sections, limit_margin_section
from pipeline.report.fit import _dependence
from pipeline.report.missing_force import missing_force_sections
from pipeline.report.page import gzip_base64, page_html, table_html, write_page
from pipeline.report.table import success_interval, table_one_report
from pipeline.report.theme import number_text
from pipeline.report.trial import STRING_SNAPSHOTS

from .conftest import JOINTS

NASTY = "</script><script>alert('x')</script> & <b>$title</b>"
VOID = {"meta", "br", "input"}


class Page(HTMLParser):
    """Checks that every element is closed in order, and collects what a reader sees; without the library's code."""

    def __init__(self, report):
        super().__init__()
        self.open, self.texts, self.elements = [], [], []
        self.html, library = page_html(report), gzip_base64(get_plotlyjs())
        assert self.html.count(library) == 1
        self.html = self.html.replace(library, "")
        self.feed(self.html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.texts.append(data)

    def all(self, attribute):
        return [of[attribute] for _, of in self.elements if attribute in of]

    @property
    def text(self):
        return " ".join(self.texts)


def figures(report):
    return [chart.figure for section in report.sections for chart in section.charts]


NASTY_SECTION = Section(
    f"Title {NASTY}",
    NASTY,
    [Chart(go.Figure(go.Scatter(x=[0], y=[1], name=NASTY)), NASTY)],
    [Table([Column(NASTY, [NASTY]), Column("share", [NASTY], bar_lengths=[0.5])], NASTY, fold_label=NASTY)],
    {NASTY: NASTY, "other": "other"},
)


@pytest.fixture(params=["trial_report", "table"])
def report(request):
    made = request.getfixturevalue(request.param)
    return made if isinstance(made, Document) else table_one_report(made)


def test_page_is_one_offline_file_whose_links_lead_to_its_sections(report):
    page = Page(report)
    assert not re.search("https?:", page.html)
    assert page.all("src") == []
    assert "default-src 'none'" in page.html
    links, ids = page.all("href"), page.all("id")
    assert set(links) == {"#top", *(f"#{section.anchor}" for section in report.sections)}
    assert len(ids) == len(set(ids))
    assert {link.removeprefix("#") for link in links} <= set(ids)
    assert sum(i.startswith("chart-") for i in ids) == len(figures(report))


def test_every_axis_has_a_name_and_a_unit(report):
    for figure in figures(report):
        layout = figure.to_dict()["layout"]
        axes = [axis for key, axis in layout.items() if re.fullmatch(r"[xy]axis\d*", key)]
        titles = [axis["title"]["text"] for axis in axes if axis.get("showticklabels", True)]
        assert len(titles) >= 2
        for title in titles:
            assert re.search(r"\[[^\]]+\]$", title), title


def test_text_of_users_cannot_become_markup():
    report = Document(NASTY, NASTY, [NASTY_SECTION], ResultLevel.BAD, NASTY, [KeyFigure(NASTY, NASTY, NASTY)], [NASTY],
                      [NextStep(NASTY, NASTY)], NASTY)  # fmt: skip
    page = Page(report)
    assert page.text.count(NASTY) >= 16
    assert "<script>alert" not in page.html
    assert sum(tag == "script" for tag, _ in page.elements) == 5
    data = re.search(r'id="data">(.*?)</script>', page.html, re.DOTALL)[1]
    assert json.loads(gzip.decompress(base64.b64decode(data)))["figures"][0]["data"][0]["name"] == NASTY


@pytest.mark.parametrize("level", ResultLevel)
def test_banner_says_the_verdict_in_words_and_colour(level):
    page = Page(Document("A", "what happened", [], level))
    classes = [attributes["class"] for _, attributes in page.elements if attributes.get("role") == "status"]
    assert classes == [f"verdict {level.name.lower()}"]
    assert level.value in page.text
    assert "what happened" in page.text


def test_trial_report_tells_its_numbers(trial, trial_report):
    error = np.abs(trial.actual - trial.reference)
    text = Page(trial_report).text
    for said in (
        f"{1e3 * np.sqrt(np.mean((trial.measured - trial.force) ** 2)):.2f} mN rms",
        f"the largest error is {1e3 * error.max():.1f} mm at {trial.time[error.argmax()]:.2f} s",
        f"The length was learnt as {trial.estimates[-1].value:.4f} m",
        "tightest is the velocity of right_s1, of which 94 % was used",
        "SAC 2 of 120 times",
        "load_force: 3 samples were left out",
    ):
        assert said in text


def test_broken_limits_are_said_and_marked(trial):
    broken = replace(trial.margins[2], used_share=1.25, value=2.5)
    limits = limit_margin_section([*trial.margins, broken])
    assert limits.sentence.startswith("Limits broken: 1 of 15; worst the velocity of right_e0, 2.50 rad/s against 2.00")
    assert "class='share over'" in table_html(limits.tables[0])
    _, speeds = joint_motion_sections(JOINTS, trial.time, trial.q, 10 * trial.v, trial.limits)
    assert "goes beyond its limit" in speeds.sentence


def test_swing_is_drawn_to_scale_with_the_string_at_its_length(trial_report):
    (figure,) = (chart.figure for chart in trial_report.section("Swing").charts)
    assert figure.layout.yaxis.scaleanchor == "x"
    (string,) = (trace for trace in figure.data if trace.name == "string")
    ends = np.column_stack([string.x, string.y]).reshape(-1, 3, 2)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert len(lengths) == STRING_SNAPSHOTS
    np.testing.assert_allclose(lengths, 0.368, rtol=1e-2)


def test_joint_panels_show_curve_and_both_limits(trial, trial_report):
    (figure,) = (chart.figure for chart in trial_report.section("Joint positions").charts)
    assert len(figure.data) == 3 * len(JOINTS)
    for i, (lower, upper) in enumerate(zip(trial.limits.lower, trial.limits.upper, strict=True)):
        curve, low, high = figure.data[3 * i : 3 * i + 3]
        np.testing.assert_array_equal(curve.y, trial.q[:, i])
        assert (low.y[0], high.y[0]) == (lower, upper)
        bottom, top = figure.layout[curve.yaxis.replace("y", "yaxis")].range
        assert bottom < lower < upper < top


def test_table_report_says_that_the_box_was_chosen(table):
    text = Page(table_one_report(table)).text
    assert "The paper gives no box. This one was chosen so that the simulation reproduces" in text
    assert "With estimation 9 of 9 guesses succeed" in text


@pytest.mark.parametrize(
    ("estimation", "succeeding", "level"),
    [(True, 20, ResultLevel.GOOD), (True, 4, ResultLevel.BAD), (False, 18, ResultLevel.CAUTION)],
)
def test_table_report_is_no_success_when_a_guess_fails_with_estimation(table, estimation, succeeding, level):
    succeeded = table.succeeded.copy()
    succeeded[0, int(estimation)] = np.arange(20) < succeeding
    assert table_one_report(replace(table, succeeded=succeeded)).level is level


@pytest.mark.parametrize(("successes", "trials"), [(0, 3), (3, 3), (19, 20), (7, 20)])
def test_interval_of_a_share_is_wilsons(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    low, high = success_interval(successes / trials, trials, z=1.959963984540054)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)


NUMBERS = [
    (0.000312, "m", "0.312 mm"), (-0.000312, "m", "−0.312 mm"), (0.368, "m", "0.368 m"), (0.0, "m", "0 m"),
    (1234.5, "N", "1234 N"), (2.0e-5, "s", "0.0200 ms"), (1.5, "", "1.50"), (float("nan"), "m", "–"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "unit", "text"), NUMBERS)
def test_numbers_read_naturally(value, unit, text):
    assert number_text(value, unit) == text


def test_report_is_written_in_one_step(tmp_path, table, complains):
    path = tmp_path / "report.html"
    path.write_text("old")
    write_page(table_one_report(table), path)
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
    with complains(InputError):
        write_page(table_one_report(table), tmp_path / "absent" / "report.html")


@pytest.mark.slow
def test_a_browser_draws_every_figure_without_an_error(tmp_path, trial_report):
    (tmp_path / "report.html").write_text(page_html(trial_report), encoding="utf-8")
    with Browser() as tab:
        tab.go((tmp_path / "report.html").as_uri())
        tab.wait(f"document.querySelectorAll('.chart.js-plotly-plot').length == {len(figures(trial_report))}")
        assert tab.errors == []


def test_a_mean_over_an_input_that_rests_at_few_values_has_no_empty_interval():
    at = np.repeat([5.0, 20.0, 60.0], [10, 100, 30])
    chart = _dependence("extra.t", "extra.heater", "W", at, np.repeat([1.0, -2.0, 3.0], [10, 100, 30]))[1]
    mean = next(trace for trace in chart.figure.data if trace.name == "mean")
    assert np.all(np.diff(mean.x) > 0.0)
    assert mean.x[0] == 5.0  # no empty interval, whose mean would be drawn at 0
    assert mean.y[0] == 1.0


def test_a_process_lacks_a_rate_and_an_arm_a_force():
    def curve(unit):
        x = np.linspace(0.0, 1.0, 20)
        return ForceCurve("run", None, unit, "block", "K", x, x, 0.1 + 0 * x)

    assert missing_force_sections([curve("K/s")])[0].title == "The missing rates"
    assert missing_force_sections([curve("N m")])[0].title == "The missing force"
