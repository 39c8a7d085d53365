"""How results look in a notebook: a card of HTML, a plotly figure, data frames."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from armdyn.experiments.plan import Plan
    from armdyn.identify.compare import Comparison
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.fit import Fit
    from armdyn.identify.missing_force import ForceCurve
    from armdyn.identify.repair import Repair
    from armdyn.model import Model
    from armdyn.run import Run

Columns = Mapping[str, Sequence[Any]]

MOST_POINTS = 2000
"""Per curve of a figure."""
MOST_ROWS = 12
"""Of a table in a card; the others are behind a line."""
MEASURED, BEFORE, AFTER = "#7B8794", "#E69F00", "#0072B2"
"""Okabe and Ito's palette, as in the reports."""
GOOD, OPEN = "#009E73", "#D55E00"
PALETTE = (AFTER, BEFORE, GOOD, "#CC79A7", OPEN, "#56B4E9", "#F0E442", MEASURED)


@dataclass(frozen=True)
class Story:
    """What there is to show of a result.

    Attributes:
        title: what it is.
        good: whether nothing is left to do; None where that is no question.
        sentence: for a person.
        tables: by name, the most important first; made when asked for.
        fits: what to plot, by the name of their curve, the model as given first.
        in_card: names of the tables that a card shows.
    """

    title: str
    sentence: str
    tables: Mapping[str, Callable[[], Columns]]
    good: bool | None = None
    fits: Mapping[str, "Fit"] = field(default_factory=dict)
    in_card: tuple[str, ...] = ("parameters", "channels")


def comparison_story(found: "Comparison") -> Story:
    """Of a model held against runs."""
    tables = {
        "parameters": lambda: _parameters(found.parameters),
        "channels": lambda: _channels(found),
        "samples": lambda: _samples(found.fit),
        "missing_force": lambda: _missing_force(found.missing_force),
    }
    return Story("Comparison", found.sentence, tables, found.explained, {"predicted": found.fit})


def diagnosis_story(found: "Diagnosis") -> Story:
    """Of what a model lacks."""
    given = found.comparison

    def candidates() -> Columns:
        return {
            "effect": [s.effect for s in found.suspects],
            "joints": [", ".join(s.joints) for s in found.suspects],
            **_fields(found.suspects, "delta_bic", "p_value"),
            "tied_with": [", ".join(s.tied_with) for s in found.suspects],
        }

    steps = found.search.steps
    fits = {"as given": given.fit} | ({"with what is missing": steps[-1].fit} if len(steps) > 1 else {})
    tables = {"candidates": candidates, **comparison_story(given).tables}
    tables["missing_force"] = lambda: _missing_force(found.missing_force)
    good = found.verdict.key == "explained"
    return Story("Diagnosis", found.sentence, tables, good, fits, ("candidates", "parameters"))


def repair_story(found: "Repair") -> Story:
    """Of a model that was repaired."""

    def steps() -> Columns:
        columns: dict[str, list[Any]] = {
            "step": [" + ".join(step.added) or "as given" for step in found.path],
            "joints": [", ".join(step.joints) for step in found.path],
        }
        for kind, errors in (("rmse", "rmse"), ("held out", "held_out_rmse")):
            for channel in found.after.channels:
                values = [getattr(step, errors).get(channel) for step in found.path]
                if any(value is not None for value in values):
                    columns[f"{kind} {channel} [{found.after.channels[channel].unit}]"] = values
        return columns | _fields(found.path, "chi2_per_sample", "bic")

    fits = {"as given": found.before.fit} | ({"repaired": found.after.fit} if len(found.path) > 1 else {})
    good = found.verdict.key == "explained"
    tables = {"steps": steps, **comparison_story(found.after).tables}
    tables["missing_force"] = lambda: _missing_force(found.missing_force)
    return Story("Repair", found.sentence, tables, good, fits, ("steps", "parameters"))


def plan_story(found: "Plan") -> Story:
    """Of what to do next."""

    def experiments() -> Columns:
        return {
            "experiment": [p.experiment.kind for p in found.proposals],
            "separation": [p.outlook.separation for p in found.proposals],
            "right verdict": [p.outlook.probability for p in found.proposals],
            "what to do": [p.experiment.what for p in found.proposals],
        }

    return Story("Next experiment", found.sentence, {"experiments": experiments}, in_card=("experiments",))


def model_story(model: "Model") -> Story:
    """Of a model by itself."""
    shared = {name: p for name, p in model.parameters.items() if p.scope == "shared"}
    return Story(
        f"Model: {model.base}", f"{model}.", {"parameters": lambda: _parameters(shared)}, in_card=("parameters",)
    )


def run_story(run: "Run") -> Story:
    """Of a recording."""
    channels, quantities = run.channels, dict.fromkeys(name.partition(".")[0] for name in run.channels)
    seconds = max((float(c.time[-1] - c.time[0]) for c in channels.values()), default=0.0)
    of_joints = f" of {len(run.joints)} joints" if run.joints else ""
    said = f"{', '.join(quantities) or 'nothing'}{of_joints}, {seconds:.4g} s"

    def listed() -> Columns:
        values = channels.values()
        return {
            "channel": list(channels), **_fields(values, "unit"), "samples": [len(c) for c in values],
            "from [s]": [float(c.time[0]) for c in values], "to [s]": [float(c.time[-1]) for c in values],
            "lowest": [float(c.value.min()) for c in values], "highest": [float(c.value.max()) for c in values],
        }  # fmt: skip

    def samples() -> Columns:
        time = np.unique(np.concatenate([c.time for c in channels.values()]))
        columns: dict[str, Sequence[Any]] = {"time": time.tolist()}
        for name, c in channels.items():
            column = np.full(len(time), np.nan)
            column[np.searchsorted(time, c.time)] = c.value
            columns[f"{name} [{c.unit}]"] = column.tolist()
        return columns

    described = f"{run.description}. " if run.description else ""
    return Story(
        f"Run {run.name}", f"{described}{said}", {"samples": samples, "channels": listed}, in_card=("channels",)
    )


def run_figure(run: "Run") -> Any:
    """A recording over time: a row for each quantity and unit, a curve for each joint."""
    go, make_subplots = _plotly()
    rows = list(dict.fromkeys((name.partition(".")[0], c.unit) for name, c in run.channels.items()))
    made = make_subplots(len(rows), 1, shared_xaxes=True, vertical_spacing=0.15 / max(len(rows), 1))
    joints = list(dict.fromkeys(name.partition(".")[2] for name in run.channels))
    shown: set[str] = set()
    for name, c in run.channels.items():
        quantity, _, joint = name.partition(".")
        row, thin = 1 + rows.index((quantity, c.unit)), slice(None, None, -(-len(c) // MOST_POINTS))
        line = {"color": PALETTE[joints.index(joint) % len(PALETTE)]}
        label = {"name": joint or name, "legendgroup": joint or name, "showlegend": (joint or name) not in shown}
        shown.add(joint or name)
        made.add_trace(go.Scatter(x=c.time[thin], y=c.value[thin], mode="lines", line=line, **label), row, 1)
    for row, (quantity, unit) in enumerate(rows, start=1):
        made.update_yaxes(title_text=f"{quantity} [{unit}]", row=row, col=1)
    return _laid_out(made, len(rows))


def frame(story: Story, what: str) -> Any:
    """A table of a story as a pandas data frame; see `Shown.to_dataframe`."""
    name = what or next(iter(story.tables))
    if name not in story.tables:
        raise UnknownNameError(f"table of a {story.title.lower()}", name, story.tables)
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("a data frame needs pandas: run 'pip install armdyn[notebook]'") from error
    return pd.DataFrame(dict(story.tables[name]()))


def figure(story: Story) -> Any:
    """Curves of a story as a plotly figure; see `Shown.plot`."""
    go, make_subplots = _plotly()
    fits = list(story.fits.items())
    blocks = [{(block.run, block.channel): block for block in fit.blocks} for _, fit in fits]
    runs = {run.name: run for run in fits[0][1].problem.runs}
    channels = list(dict.fromkeys(channel for _, channel in blocks[0]))
    made = make_subplots(len(channels), 1, shared_xaxes=True, vertical_spacing=0.15 / len(channels))
    owner: list[str] = []
    for (name, channel), first in blocks[0].items():
        row, thin = 1 + channels.index(channel), slice(None, None, -(-len(first.time) // MOST_POINTS))
        source = runs[name].channels[channel]
        measured = np.interp(first.time, source.time, source.value)
        curves = [("measured", measured, {"mode": "markers", "marker": {"color": MEASURED, "size": 3}})]
        for (label, _), colour, dash, by in zip(
            fits, _colours(len(fits)), ("dash", "solid")[-len(fits) :], blocks, strict=True
        ):
            line = {"color": colour, "width": 2, "dash": dash}
            curves.append((label, measured - by[name, channel].misfit, {"mode": "lines", "line": line}))
        for label, values, look in curves:
            shown = {"legendgroup": label, "showlegend": row == 1, "visible": name == next(iter(runs))}
            made.add_trace(go.Scatter(x=first.time[thin], y=values[thin], name=label, **shown, **look), row, 1)
            owner.append(name)
    for row, channel in enumerate(channels, start=1):
        unit = next(run.channels[channel].unit for run in runs.values() if channel in run.channels)
        made.update_yaxes(title_text=f"{channel} [{unit}]", row=row, col=1)
    _laid_out(made, len(channels))
    if len(runs) > 1:
        buttons = [
            {"label": name, "method": "update", "args": [{"visible": [run == name for run in owner]}]} for name in runs
        ]
        made.update_layout(
            updatemenus=[{"buttons": buttons, "x": 1.0, "xanchor": "right", "y": 1.0, "yanchor": "bottom"}]
        )
    return made


def _plotly() -> tuple[Any, Any]:
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    except ImportError as error:
        raise InputError("a plot needs plotly: run 'pip install plotly'") from error
    return go, make_subplots


def _laid_out(made: Any, rows: int) -> Any:
    """A figure of so many rows over time."""
    made.update_xaxes(title_text="time [s]", row=rows, col=1)
    return made.update_layout(
        height=120 + 200 * rows, margin={"t": 60, "r": 10}, template="plotly_white",
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip


def _colours(count: int) -> tuple[str, ...]:
    return (BEFORE, AFTER)[-count:]


def card(story: Story) -> str:
    """A story as HTML that is at home on light and dark pages."""
    colour = "currentColor" if story.good is None else GOOD if story.good else OPEN
    head = f"<b>{escape(story.title)}</b><br>{escape(story.sentence)}"
    tables = "".join(_html(name, story.tables[name]()) for name in story.in_card)
    return f"<div style='border-left:4px solid {colour};padding:2px 12px;max-width:60em'>{head}{tables}</div>"


def _html(name: str, columns: Columns) -> str:
    columns = {key: values for key, values in columns.items() if any(value not in (None, "") for value in values)}
    header = "".join(f"<th style='text-align:left'>{escape(key.replace('_', ' '))}</th>" for key in columns)
    lines = [
        f"<tr>{''.join(f'<td>{escape(_text(value))}</td>' for value in row)}</tr>"
        for row in zip(*columns.values(), strict=True)
    ]
    if not lines:
        return ""
    table = f"<table><thead><tr>{header}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    return (
        f"<details><summary>{len(lines)} {escape(name)}</summary>{table}</details>" if len(lines) > MOST_ROWS else table
    )


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _fields(items: Collection[Any], *names: str) -> dict[str, list[Any]]:
    """A column per attribute of the items."""
    return {name: [getattr(item, name) for item in items] for name in names}


def _parameters(found: Mapping[str, Any]) -> Columns:
    return {"parameter": list(found), **_fields(found.values(), "value", "std", "unit", "fitted")}


def _channels(found: "Comparison") -> Columns:
    values = found.channels.values()
    noise = {"noise": [c.noise_std for c in values]}
    shown = _fields(values, "rmse", "held_out_rmse", "chi2_per_sample")
    return {"channel": list(found.channels), **_fields(values, "unit"), **noise, **shown}


def _samples(fit: "Fit") -> Columns:
    runs = {run.name: run for run in fit.problem.runs}
    columns: dict[str, list[Any]] = {key: [] for key in ("run", "channel", "time", "measured", "predicted")}
    for block in fit.blocks:
        source = runs[block.run].channels[block.channel]
        measured = np.interp(block.time, source.time, source.value)
        columns["run"] += [block.run] * len(block.time)
        columns["channel"] += [block.channel] * len(block.time)
        columns["time"] += block.time.tolist()
        columns["measured"] += measured.tolist()
        columns["predicted"] += (measured - block.misfit).tolist()
    return columns


def _missing_force(curves: "Sequence[ForceCurve]") -> Columns:
    """A row per point of every curve."""
    columns: dict[str, list[Any]] = {key: [] for key in ("run", "joint", "unit", "against", "x_unit")}
    for key, values in columns.items():
        for curve in curves:
            values += [getattr(curve, key)] * len(curve.x)
    for key in ("x", "as_given", "std", "repaired"):
        rows = [getattr(curve, key) for curve in curves]
        columns[key] = [v for c, row in zip(curves, rows, strict=True) for v in (c.x * np.nan if row is None else row)]
    return columns
