"""Results in a notebook: small, without scripts, and the same numbers as in the result."""

import json
import re
import sys

import numpy as np
import pytest
from worlds.pendulum import Setup, record

import armdyn
from armdyn.errors import InputError, UnknownNameError

DRAG = Setup(duration=4.0, hidden={"linear_drag": 3e-2})


@pytest.fixture(scope="module")
def runs():
    return [record(f"{name}.csv", DRAG, np.random.default_rng(seed)) for seed, name in enumerate("ab")]


@pytest.fixture(scope="module")
def model():
    return armdyn.pendulum.pendulum_model(length=0.36, mass=0.08)


@pytest.fixture(scope="module")
def results(model, runs):
    effects = [armdyn.CATALOGUE["linear_drag"], armdyn.CATALOGUE["sensor_bias"]]
    return {
        "fit": armdyn.fit(model, runs),
        "compare": armdyn.compare(model, runs),
        "diagnose": armdyn.diagnose(model, runs, effects=effects),
        "repair": armdyn.repair(model, runs, effects=effects),
    }


@pytest.mark.parametrize("name", ["fit", "compare", "diagnose", "repair"])
def test_a_card_is_small_and_stands_alone(results, name):
    html = results[name]._repr_html_()
    assert 300 < len(html) < 20_000
    assert not re.search(r"<script|src=|href=|@import", html)
    assert html.count("<table>") == html.count("</table>") >= 1
    if name != "fit":
        assert results[name].sentence.split(";")[0][:40] in html


def test_a_run_shows_itself_and_becomes_a_data_frame_and_back(runs):
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    run = runs[0]
    html = run._repr_html_()
    assert len(html) < 5_000
    assert "load_force" in html
    frame = run.to_dataframe()
    assert list(frame.columns[:1]) == ["time"]
    again = armdyn.Run.from_dataframe(frame)
    np.testing.assert_array_equal(again.channels["load_force"].value, run.channels["load_force"].value)
    assert list(run.to_dataframe("channels")["channel"]) == list(run.channels)
    figure = run.plot()
    assert len(figure.data) == len(run.channels)
    np.testing.assert_array_equal(figure.data[0].y, next(iter(run.channels.values())).value)
    assert figure.layout.yaxis.title.text.endswith("]")


def test_names_cannot_break_out_of_a_card(runs, model):
    run = armdyn.Run("<b onclick=x>.csv", runs[0].channels, {}, runs[0].noise)
    assert "<b onclick" not in armdyn.compare(model, [run, runs[1]])._repr_html_()


def test_a_plot_shows_what_was_measured_and_predicted(results, runs):
    figure = results["repair"].plot()
    curves = {trace.name: trace for trace in figure.data if trace.visible is not False}
    assert set(curves) == {"measured", "as given", "repaired"}
    force = runs[0].channels["load_force"].value
    np.testing.assert_allclose(curves["measured"].y, force, atol=1e-12)
    rms = {name: np.std(curves[name].y - force) for name in ("as given", "repaired")}
    assert rms["repaired"] == pytest.approx(0.003, rel=0.2)
    assert rms["as given"] > 1.5 * rms["repaired"]
    assert [button.label for button in figure.layout.updatemenus[0].buttons] == ["a.csv", "b.csv"]
    assert figure.layout.yaxis.title.text == "load_force [N]"


def test_a_figure_is_still_there_when_its_notebook_became_a_page(results):
    bundle = json.loads(json.dumps(results["repair"].plot()._repr_mimebundle_()))  # as a notebook is saved
    assert "as given" in bundle["text/html"]
    assert bundle["text/plain"] == "figure: measured, as given, repaired"
    nbformat = pytest.importorskip("nbformat", reason="pages are made by nbconvert: pip install nbconvert")
    exporters = pytest.importorskip("nbconvert.exporters", reason="pages are made by nbconvert: pip install nbconvert")
    shown = nbformat.v4.new_output("display_data", bundle)
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("results.plot()", outputs=[shown])])
    page, _ = exporters.HTMLExporter().from_notebook_node(notebook)
    assert "Plotly.newPlot" in page
    text, _ = exporters.MarkdownExporter().from_notebook_node(notebook)
    assert "as given" in text


def test_held_out_and_exam_runs_are_plotted_and_in_the_samples(results, runs):
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    first, second = runs
    exam = record("c.csv", DRAG, np.random.default_rng(2))
    found = armdyn.compare(results["fit"], first, held_out=[second], exam=[exam])
    samples = found.to_dataframe("samples")
    assert samples.groupby("role")["run"].unique().map(list).to_dict() == {
        "training": ["a.csv"], "held_out": ["b.csv"], "exam": ["c.csv"]
    }  # fmt: skip
    held_out = samples[samples["role"] == "held_out"]
    rmse = float(np.sqrt(np.mean((held_out["measured"] - held_out["predicted"]) ** 2)))
    assert rmse == pytest.approx(found.channels["load_force"].held_out_rmse)
    shown = [button.label for button in found.plot().layout.updatemenus[0].buttons]
    assert shown == ["a.csv", "b.csv (held out)", "c.csv (exam)"]


def test_a_plan_is_plotted_as_what_each_rival_predicts(runs, model):
    rivals = ["linear_drag", "quadratic_drag"]
    plan = armdyn.next_experiment(model, runs, rivals=rivals, seconds=4.0, travel=0.3, speed=0.5)
    curves = [trace for trace in plan.plot().data if trace.name in rivals]
    assert {trace.name for trace in curves} == set(rivals)
    ends = [trace.x[-1] for trace in curves]
    assert min(ends) >= 4.0
    one, other = (next(trace.y for trace in curves if trace.name == name) for name in rivals)
    assert [one[0], other[0]] == pytest.approx([0.08 * 9.81] * 2, rel=0.01)  # the load hangs at rest
    assert np.abs(one - other).max() > 0.01


def test_a_fitted_model_is_plotted_against_recordings(results, runs):
    shown = armdyn.compare(results["fit"], runs).plot().data
    assert [trace.name for trace in shown[:3]] == ["measured", "95 % band", "predicted"]
    assert len(shown) == 6


def test_data_frames_hold_the_results(results, complains):
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    steps = results["repair"].to_dataframe()
    assert list(steps["step"]) == ["as given", "linear_drag"]
    assert steps["rmse load_force [N]"].iloc[1] < steps["rmse load_force [N]"].iloc[0]
    parameters = results["repair"].to_dataframe("parameters").set_index("parameter")
    drag = results["repair"].after.parameters["linear_drag.coefficient"]
    assert parameters.loc["linear_drag.coefficient", "value"] == drag.value
    assert parameters.loc["linear_drag.coefficient", "unit"] == "N s/m"
    samples = results["compare"].to_dataframe("samples")
    rmse = float(np.sqrt(np.mean((samples["measured"] - samples["predicted"]) ** 2)))
    assert rmse == pytest.approx(results["compare"].channels["load_force"].rmse)
    assert results["diagnose"].to_dataframe()["effect"].iloc[0] == "linear_drag"
    with complains(UnknownNameError):
        results["fit"].to_dataframe("parameter")


@pytest.mark.parametrize(("missing", "what"), [("pandas", "to_dataframe"), ("plotly.subplots", "plot")])
def test_what_is_missing_is_named(results, monkeypatch, missing, what, complains):
    monkeypatch.setitem(sys.modules, missing, None)
    with complains(InputError):
        getattr(results["compare"], what)()
