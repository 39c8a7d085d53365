"""What a page shows in a real browser, by the boxes of its parts: nothing over anything else, on any screen."""

import json
import shutil
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from browser import Browser, chromium
from scipy.integrate import solve_ivp

from armdyn.document import Chart, Document, Section, Table
from pipeline.report.page import write_page
from pipeline.report.theme import FOLLOWS_BULK

ROOT = Path(__file__).parents[3]
OVERLAPS = """(() => {
  const box = (part) => part?.getBoundingClientRect();
  const over = (a, b) => a && b && a.width && b.width && a.right > b.left + 1 && b.right > a.left + 1
    && a.bottom > b.top + 1 && b.bottom > a.top + 1;
  const found = [];
  document.querySelectorAll(".js-plotly-plot").forEach((chart) => {
    if (!chart.offsetParent) return;
    const [legend, bar] = [".legend", ".modebar"].map((part) => box(chart.querySelector(part)));
    if (legend && legend.height > 0.18 * box(chart).height) found.push(`${chart.id}: a legend of ${legend.height} px`);
    if (over(legend, bar)) found.push(`${chart.id}: legend and tool bar`);
    chart.querySelectorAll(".bglayer rect, .plotbg, .xtitle, .ytitle").forEach((part) => {
      if (over(legend, box(part))) found.push(`${chart.id}: legend and ${part.getAttribute("class")}`);
    });
    chart.querySelectorAll(".plot").forEach((part) => {
      const grid = box(part.closest("g.subplot")?.querySelector(".gridlayer"));
      if (over(legend, grid)) found.push(`${chart.id}: legend and grid`);
    });
    const scrolls = /auto|scroll/.test(getComputedStyle(chart.parentElement).overflowX);
    if (!scrolls && box(chart).right > innerWidth + 1) found.push(`${chart.id}: wider than the screen`);
    chart.querySelectorAll(".xtitle, .ytitle, .y2title").forEach((part) => {
      if (!/\\[.+\\]/.test(part.textContent)) found.push(`${chart.id}: axis '${part.textContent}' without a unit`);
    });
    if (!chart.querySelector(".ytitle")) found.push(`${chart.id}: no title at y`);
  });
  if (document.scrollingElement.scrollWidth > innerWidth + 1) found.push("the page is wider than the screen");
  document.querySelectorAll(".readout").forEach((part) => {
    if (part.textContent.includes("no such channel")) found.push(part.textContent);
  });
  return [document.querySelectorAll(".js-plotly-plot").length, ...found];
})()"""


def write_tanks(folder):
    """A day of two tanks by scipy; their levels are not channels, one of them is measured."""
    shutil.copy(ROOT / "examples/tanks.py", folder)
    time = np.arange(0.0, 800.0, 2.0)

    def rates(t, levels):
        out, below = 0.09 * np.sqrt(max(levels[0], 0.0)), 0.075 * np.sqrt(max(levels[1], 0.0))
        return 0.055 * (3.2 + np.sin(0.025 * t)) - out, out - below

    level = solve_ivp(rates, (0.0, 800.0), (5.0, 5.0), t_eval=time, max_step=1.0).y[1]
    level += 0.03 * np.random.default_rng(1).normal(size=len(time))
    table = np.column_stack([time, 3.2 + np.sin(0.025 * time), level])
    head = "time [s],extra.pump [V],extra.level [V]"
    np.savetxt(folder / "day.csv", table, "%.5f", ",", header=head, comments="")


def write_swing(folder):
    """A decaying swing."""
    time = np.arange(0.0, 12.0, 0.02)
    angle = 0.5 * np.exp(-0.05 * time) * np.cos(5.0 * time) + 1e-3 * np.random.default_rng(1).normal(size=len(time))
    head = "time [s],swing_angle [rad]"
    np.savetxt(folder / "day.csv", np.column_stack([time, angle]), "%.6f", ",", header=head, comments="")


@pytest.mark.parametrize(
    ("write", "new"),
    [(write_tanks, ("--base", "tanks.py", "m.toml")), (write_swing, ("pendulum", "m.toml"))],
    ids=["tanks", "swing"],
)
def test_no_part_of_a_page_lies_over_another(write, new, tmp_path, monkeypatch, armdyn):
    chromium()
    monkeypatch.chdir(tmp_path)
    write(tmp_path)
    assert armdyn("new", *new)[0] == 0
    assert armdyn("compare", "m.toml", "day.csv", "--report", "r.html")[0] == 0
    with Browser(1600, 1000) as tab:
        tab.go((tmp_path / "r.html").as_uri())
        for width in (1600, 1024, 390):
            tab.resize(width, 900)
            tab.wait("document.body.dataset.ready === 'yes'")
            tab.ask("new Promise((done) => setTimeout(done, 600))")
            count, *found = tab.ask(OVERLAPS)
            assert count > 2
            assert not found, (width, json.dumps(found))
        assert not tab.errors


def test_on_a_phone_value_and_deviation_of_a_long_name_are_in_sight(tmp_path):
    chromium()
    name, what = "joint_viscous_friction.coefficient[FL_thigh_joint]", "torque per speed, of the motor and of its gears"
    table = Table.of(["parameter", "value", "std", "what it is"], [[name, 0.0493767, 0.00033, what]])
    write_page(Document("Values", "some", [Section("Parameters", tables=[table])]), tmp_path / "r.html")
    with Browser(390, 844) as tab:
        tab.go((tmp_path / "r.html").as_uri())
        tab.wait("document.body.dataset.ready === 'yes'")
        ends = tab.ask("[...document.querySelectorAll('td')].map((cell) => cell.getBoundingClientRect().right)")
        assert max(ends[:3]) < 390.0


def test_a_spike_leaves_the_axis_and_is_told(tmp_path):
    chromium()
    time, rng = np.arange(0.0, 10.0, 0.01), np.random.default_rng(0)
    value = rng.normal(size=len(time))
    charts = []
    for spikes in ((), (400, 401, 800)):
        figure = go.Figure(layout={"height": 300, "meta": FOLLOWS_BULK})
        figure.add_scatter(x=time, y=np.where(np.isin(np.arange(len(time)), spikes), -500.0, value), name="samples")
        charts.append(Chart(figure.update_yaxes(title_text="residual [N m]").update_xaxes(title_text="time [s]")))
    write_page(Document("Spikes", "some", [Section("Two", charts=charts)]), tmp_path / "r.html")
    with Browser() as tab:
        tab.go((tmp_path / "r.html").as_uri())
        tab.wait("document.body.dataset.ready === 'yes'")
        calm, torn = tab.ask("[...document.querySelectorAll('.chart')].map((chart) => chart._fullLayout.yaxis.range)")
        assert calm[0] < value.min() < value.max() < calm[1]
        assert -10.0 < torn[0] < torn[1] < 10.0
        (said,) = tab.ask("[...document.querySelectorAll('.outside')].map((line) => line.textContent)")
        assert said.startswith("Points outside the axes: 3 of “samples”, up to −500 N m.")
        for _ in range(2):  # as the line under the figure says
            tab.click("#chart-1 .nsewdrag")
        low, _ = tab.ask("document.querySelector('#chart-1')._fullLayout.yaxis.range")
        assert low < -500.0
        assert not tab.errors
