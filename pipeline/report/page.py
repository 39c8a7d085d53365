"""A document as one offline HTML page: a verdict, key figures, sections with figures and tables, and plotly.js once."""

import base64
import gzip
import json
from collections.abc import Mapping
from functools import cache
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from armdyn import __version__, atomic
from armdyn.document import Chart, Document, ResultLevel, Section, Table, Widget
from armdyn.quoting import script_json
from pipeline.report.theme import DARK, TEMPLATE


def table_html(table: Table) -> str:
    """A table as HTML, every text escaped; a column whose cells are all numbers is set to the right."""
    columns = []
    for column in table.nonempty_columns:
        texts, right = column.texts, not column.bar_lengths and all(map(_is_number, column.texts))
        cells = [_cell("td", text, right) for text in texts]
        if column.bar_lengths:
            pairs = zip(texts, column.bar_lengths, strict=True)
            cells = [bar(text, share, judged=column.bar_coloured_by_length) for text, share in pairs]
        columns.append([_cell("th", column.heading, right), *cells])
    head, *body = [""] if not columns else ["".join(cells) for cells in zip(*columns, strict=True)]
    rows = "".join(f"<tr>{row}</tr>" for row in body)
    caption = f"<p class='caption'>{escape(table.caption)}</p>" if table.caption else ""
    made = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    shown = f"<div class='table'>{made}</div>{caption}"
    return f"<details><summary>{escape(table.fold_label)}</summary>{shown}</details>" if table.fold_label else shown


def _is_number(text: str) -> bool:
    return not text or text[0].isdigit() or text[0] in "-–−+±<"


MIN_WORDS_LENGTH = 40
"""Characters of a cell that needs room, so that it does not become a tower of single words on a narrow screen."""


def _cell(tag: str, text: str, number: bool) -> str:
    kind = " class=number" if number else " class=words" if tag == "td" and len(text) > MIN_WORDS_LENGTH else ""
    return f"<{tag}{kind}>{escape(text)}</{tag}>"


def bar(text: str, share: float, *, judged: bool = True) -> str:
    """A cell with a bar behind its text; where `judged`, the bar's colour depends on its length."""
    kind = "fine" if not judged else "over" if share > 1.0 else "close" if share > 0.9 else "fine"
    width = 100 * min(max(share, 0.0), 1.0)
    return f"<td class='share {kind}'><span style='width: {width:.1f}%'></span><b>{escape(text)}</b></td>"


def page_html(document: Document) -> str:
    """A document as one HTML file that works offline, without other files."""
    figures: list[dict[str, Any]] = []
    widgets: list[Mapping[str, Any]] = []
    sections = "".join(_section(section, figures, widgets) for section in document.sections)
    level = document.level or ResultLevel.CAUTION
    return Template(template("report", "page.html")).substitute(
        head=page_head(document.title),
        title=escape(document.title),
        subtitle=escape(document.subtitle),
        level=level.name.lower(),
        word=escape(level.value),
        verdict=escape(document.verdict),
        navigation="".join(f"<a href='#{s.anchor}'>{escape(s.title)}</a>" for s in document.sections),
        key_figures="".join(key_html(figure.name, figure.value, figure.note) for figure in document.key_figures),
        notes="".join(f"<p class='note'>{escape(note)}</p>" for note in document.notes),
        next_steps="".join(
            f"<p class='next'>{escape(step.what)}:<code>{escape(step.command)}</code></p>"
            for step in document.next_steps
        ),
        sections=sections,
        footer=escape(f"armdyn {__version__}" + (f" · {document.command}" if document.command else "")),
        script=template("report", "page.js"),
        draw=template("report", "draw.js"),
        overlay=template("report", "overlay.js"),
        look=script_json(FIGURE_LOOK),
        data=packed(script_json({"figures": figures, "widgets": widgets})),
        plotly=_library(),
    )


def write_page(document: Document, path: Path | str) -> None:
    """Write the page in one step.

    Raises:
        InputError: the file cannot be written.
    """
    atomic.write_text(Path(path), page_html(document))


def _section(section: Section, figures: list[dict[str, Any]], widgets: list[Mapping[str, Any]]) -> str:
    """HTML of a section; the figures that the script draws are appended to `figures` and `widgets`."""
    heading = f"<h2>{escape(section.title)}</h2>"
    if section.sentence:
        heading += f"<p class='sentence'>{escape(section.sentence)}</p>"
    heading += tabs_html(section.tabs, section.anchor)
    if section.widget is not None:
        heading += f"<form class='widget' id='widget-{len(widgets)}'>{widget_html(section.widget)}</form>"
        widgets.append(section.widget.data)
    charts = [_chart(chart, figures) for chart in section.charts]
    # On paper the heading stays with the first figure.
    together = f"<div class='together'>{heading}{''.join(charts[:1])}</div>"
    tables = "".join(map(table_html, section.tables))
    return f"<section id='{section.anchor}'>{together}{''.join(charts[1:])}{tables}</section>"


def key_html(name: str, value: str, note: str, attributes: str = "") -> str:
    """HTML of a number in large type."""
    below = f"<small>{escape(note)}</small>" if note else ""
    return f"<div class='key'{attributes}><span>{escape(name)}</span><strong>{escape(value)}</strong>{below}</div>"


def widget_html(widget: Widget) -> str:
    """HTML of a widget: its controls, and the place for the figure that the page's script draws."""
    return f"{widget.html}<div class='chart' style='height: {widget.height}px'></div><p class='caption'></p>"


def tabs_html(tabs: Mapping[str, str], anchor: str) -> str:
    """HTML of radio buttons that choose what all sections show; empty where there is nothing to choose."""
    return pills("tabs", "Show", f"tab-{anchor}", {f"data-tab='{escape(name)}'": text for name, text in tabs.items()})


def pills(kind: str, legend: str, name: str, options: Mapping[str, str]) -> str:
    """HTML of radio buttons in a row; empty where there is nothing to choose.

    Args:
        kind: CSS class of the row.
        legend: text above the buttons.
        name: HTML name that the buttons share.
        options: text of each button, by its HTML attributes.
    """
    if len(options) < 2:
        return ""
    buttons = "".join(
        f"<label><input type='radio' name='{name}' {attributes}><span>{escape(text)}</span></label>"
        for attributes, text in options.items()
    )
    return f"<fieldset class='pills {kind}'><legend>{legend}</legend>{buttons}</fieldset>"


def _chart(chart: Chart, figures: list[dict[str, Any]]) -> str:
    whole = chart.figure if isinstance(chart.figure, Mapping) else json.loads(chart.figure.to_json())
    figure = _light({"data": whole["data"], "layout": dict(whole["layout"])})
    figure["layout"].pop("template", None)
    height = figure["layout"].get("height", 360)
    place = f"<div class='chart' id='chart-{len(figures)}' style='height: {height}px'></div>"
    if (figure["layout"].get("meta") or {}).get("wide"):
        place = f"<div class='wide'>{place}</div>"
    figures.append(figure)
    html = place + (f"<p class='caption'>{escape(chart.caption)}</p>" if chart.caption else "")
    return f"<div data-of='{escape(chart.tab)}'>{html}</div>" if chart.tab else html


PICTURE_PRECISION = 1e-5
"""Of an array's span: finer than a screen shows."""


def _light(value: Any) -> Any:
    """A figure's JSON with arrays in single precision, where that is fine enough for a picture."""
    if isinstance(value, list):
        return [_light(entry) for entry in value]
    if not isinstance(value, dict):
        return value
    if value.get("dtype") != "f8":
        return {key: _light(entry) for key, entry in value.items()}
    array = np.frombuffer(base64.b64decode(value["bdata"]), dtype="<f8")
    finite = array[np.isfinite(array)]
    if finite.size == 0 or np.spacing(np.float32(np.abs(finite).max())) > PICTURE_PRECISION * np.ptp(finite):
        return value
    return {**value, "dtype": "f4", "bdata": base64.b64encode(array.astype("<f4").tobytes()).decode()}


def template(package: str, name: str) -> str:
    """Text of a file of HTML, CSS or JavaScript of a package of `pipeline`, such as ``"report"``."""
    return (Path(__file__).parents[1] / package / "templates" / name).read_text(encoding="utf-8")


FIGURE_LOOK = {"template": TEMPLATE, "dark": DARK}


def page_head(title: str, style: str = "") -> str:
    """HTML before the body of an offline page; it forbids loading anything from elsewhere."""
    style = template("report", "style.css") + style
    return Template(template("report", "head.html")).substitute(title=escape(title), style=style)


@cache
def _library() -> str:
    from plotly.offline import get_plotlyjs

    return packed(get_plotlyjs())


def packed(text: str) -> str:
    """Text compressed with gzip for a page, in base64: a quarter of the size, readable by browsers since 2023."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
