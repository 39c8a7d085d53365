"""Show a document in a notebook: a card of HTML, a plotly figure, data frames."""

from html import escape
from typing import Any

from armdyn.document import MAX_CARD_ROWS, Curve, Document, ResultLevel, Table
from armdyn.errors import InputError, UnknownNameError

MAX_CURVE_POINTS = 2000
"""Largest number of points per curve of a figure."""
GREY, ORANGE, BLUE, GREEN, VERMILLION = "#7B8794", "#E69F00", "#0072B2", "#009E73", "#D55E00"
"""Colours of Okabe and Ito's palette, as in the reports."""
PALETTE = (BLUE, ORANGE, GREEN, "#CC79A7", VERMILLION, "#56B4E9", "#F0E442", GREY)


def html_card(document: Document) -> str:
    """Render a document as a short piece of HTML that is readable on light and dark pages."""
    colour = "currentColor" if document.level is None else GREEN if document.level is ResultLevel.GOOD else VERMILLION
    head = f"<b>{escape(document.title)}</b><br>{escape(document.verdict)}"
    tables = "".join(_html(table) for table in document.tables if table.name)
    return f"<div style='border-left:4px solid {colour};padding:2px 12px;max-width:60em'>{head}{tables}</div>"


def _html(table: Table) -> str:
    columns = table.columns_kept_when_narrow
    if not columns:
        return ""
    header = "".join(f"<th style='text-align:left'>{escape(column.heading)}</th>" for column in columns)
    rows = zip(*(column.texts for column in columns), strict=True)
    body = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    made = f"<table><thead><tr>{header}</tr></thead><tbody>{body}</tbody></table>"
    folded = f"<details><summary>{len(table)} {escape(table.name)}</summary>{made}</details>"
    return folded if len(table) > MAX_CARD_ROWS else made


def data_frame(document: Document, what: str) -> Any:
    """Convert the table `what` of a document to a pandas data frame; see `Displayable.to_dataframe`."""
    tables = {table.name: lambda table=table: table.values for table in document.tables if table.name}
    made = tables | dict(document.data)
    name = what or document.default_table or next(iter(made))
    if name not in made:
        raise UnknownNameError(f"table of a {document.title.lower()}", name, made)
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("a data frame needs pandas: run 'pip install armdyn[notebook]'") from error
    return pd.DataFrame(dict(made[name]()))


def plotly_figure(document: Document) -> Any:
    """Draw the curves of a document as a plotly figure, with a panel for each quantity; see `Displayable.plot`."""
    if document.curves is None:
        raise InputError(f"{document.title}: nothing to plot; of a model plot what 'armdyn.compare' gives")
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots

        from armdyn.notebook_figure import OfflineFigure
    except ImportError as error:
        raise InputError("a plot needs plotly: run 'pip install plotly'") from error
    curves = list(document.curves())
    rows, runs = list(dict.fromkeys(c.panel for c in curves)), list(dict.fromkeys(c.run for c in curves))
    labels = list(dict.fromkeys(c.label for c in curves if not c.drawn_as_points))
    palette = (ORANGE, BLUE)[-len(labels) :] if any(c.drawn_as_points for c in curves) else PALETTE
    made = make_subplots(len(rows), 1, shared_xaxes=True, vertical_spacing=0.15 / max(len(rows), 1))
    listed: set[tuple[str, str]] = set()
    for curve in curves:
        if curve.half_width is not None:
            made.add_trace(_band(go, curve, curve.run == runs[0]), 1 + rows.index(curve.panel), 1)
        thin = slice(None, None, -(-len(curve.time) // MAX_CURVE_POINTS))
        shown: dict[str, Any] = {"legendgroup": curve.label, "showlegend": (curve.run, curve.label) not in listed}
        listed.add((curve.run, curve.label))
        if curve.drawn_as_points:
            shown |= {"mode": "markers", "marker": {"color": GREY, "size": 3}}
        else:
            number = labels.index(curve.label)
            dash = "dash" if len(palette) == 2 and number == 0 else "solid"
            shown |= {"mode": "lines", "line": {"color": palette[number % len(palette)], "dash": dash}}
        trace = go.Scatter(
            x=curve.time[thin],
            y=curve.value[thin],
            name=curve.label,
            visible=curve.run == runs[0],
            meta=curve.run,
            **shown,
        )
        made.add_trace(trace, 1 + rows.index(curve.panel), 1)
    for number, title in enumerate(rows, start=1):
        made.update_yaxes(title_text=title, row=number, col=1)
    made.update_xaxes(title_text="time [s]", row=len(rows), col=1)
    made.update_layout(
        height=120 + 200 * len(rows), margin={"t": 60, "r": 10}, template="plotly_white",
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip
    if len(runs) > 1:
        buttons = [
            {"label": run, "method": "update", "args": [{"visible": [trace.meta == run for trace in made.data]}]}
            for run in runs
        ]
        menu = {"buttons": buttons, "x": 1.0, "xanchor": "right", "y": 1.0, "yanchor": "bottom"}
        made.update_layout(updatemenus=[menu])
    return OfflineFigure(made)


def _band(go: Any, curve: Curve, shown: bool) -> Any:
    """A band around a curve, as a closed polygon."""
    thin = slice(None, None, -(-len(curve.time) // MAX_CURVE_POINTS))
    time, middle = curve.time[thin].tolist(), curve.value[thin]
    half = middle * 0.0 if curve.half_width is None else curve.half_width[thin]
    outline = [*(middle + half).tolist(), *reversed((middle - half).tolist())]
    return go.Scatter(
        x=[*time, *reversed(time)], y=outline, name="95 % band", meta=curve.run, visible=shown, showlegend=False,
        legendgroup=curve.label, mode="lines", line={"width": 0}, fill="toself", fillcolor="rgba(0, 114, 178, 0.18)",
        hoverinfo="skip",
    )  # fmt: skip
