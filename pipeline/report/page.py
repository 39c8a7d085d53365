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
from pipeline.report.theme import DARK_COLOURS, PLOTLY_TEMPLATE


def table_html(table: Table) -> str:
    """A table as HTML, every text escaped; a column whose cells are all numbers is set to the right."""
    columns = []
    for column in table.nonempty_columns:
        texts, right = column.texts, not column.bar_lengths and all(map(_is_number, column.texts))
        cells = [_cell("td", text, right) for text in texts]
        if column.bar_lengths:
            pairs = zip(texts, column.bar_lengths, strict=True)
            cells = [bar_cell_html(text, share, judged=column.bar_coloured_by_length) for text, share in pairs]
        columns.append([_cell("th", column.heading, right), *cells])
    head, *body = [""] if not columns else ["".join(cells) for cells in zip(*columns, strict=True)]
    rows = "".join(f"<tr>{row}</tr>" for row in body)
    caption = f"<p class='caption'>{escape(table.caption)}</p>" if table.caption else ""
    made = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    shown = f"<div class='table'>{made}</div>{caption}"
    return f"<details><summary>{escape(table.fold_label)}</summary>{shown}</details>" if table.fold_label else shown


def _is_number(text: str) -> bool:
    return not text or text[0].isdigit() or text[0] in "-–−+±<"


MIN_WIDE_CELL_CHARACTERS = 40
"""Number of characters from which a cell of a table gets a minimum width, for narrow screens."""


def _cell(tag: str, text: str, number: bool) -> str:
    kind = " class=number" if number else " class=words" if tag == "td" and len(text) > MIN_WIDE_CELL_CHARACTERS else ""
    return f"<{tag}{kind}>{escape(text)}</{tag}>"


def bar_cell_html(text: str, share: float, *, judged: bool = True) -> str:
    """HTML of a table's cell with a bar behind its text.

    Args:
        text: text of the cell.
        share: length of the bar, as a share of the cell's width.
        judged: whether the bar's colour warns of a share near or above 1.
    """
    kind = "fine" if not judged else "over" if share > 1.0 else "close" if share > 0.9 else "fine"
    width = 100 * min(max(share, 0.0), 1.0)
    return f"<td class='share {kind}'><span style='width: {width:.1f}%'></span><b>{escape(text)}</b></td>"


def page_html(document: Document) -> str:
    """HTML page of a document; the page needs no other file and no network."""
    figures: list[dict[str, Any]] = []
    widgets: list[Mapping[str, Any]] = []
    sections = "".join(_section(section, figures, widgets) for section in document.sections)
    level = document.level or ResultLevel.CAUTION
    return Template(template_text("report", "page.html")).substitute(
        head=page_head_html(document.title),
        title=escape(document.title),
        subtitle=escape(document.subtitle),
        level=level.name.lower(),
        word=escape(level.value),
        verdict=escape(document.verdict),
        navigation="".join(f"<a href='#{s.anchor}'>{escape(s.title)}</a>" for s in document.sections),
        key_figures="".join(key_figure_html(figure.name, figure.value, figure.note) for figure in document.key_figures),
        notes="".join(f"<p class='note'>{escape(note)}</p>" for note in document.notes),
        next_steps="".join(
            f"<p class='next'>{escape(step.what)}:<code>{escape(step.command)}</code></p>"
            for step in document.next_steps
        ),
        sections=sections,
        footer=escape(f"armdyn {__version__}" + (f" · {document.command}" if document.command else "")),
        script=template_text("report", "page.js"),
        draw=template_text("report", "draw.js"),
        overlay=template_text("report", "overlay.js"),
        look=script_json(PLOTLY_LOOK),
        data=gzip_base64(script_json({"figures": figures, "widgets": widgets})),
        plotly=_library(),
    )


def write_page(document: Document, path: Path | str) -> None:
    """Write the HTML page of a document to a file, which is never half written.

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


def key_figure_html(name: str, value: str, note: str, attributes: str = "") -> str:
    """HTML of a key figure: a value in large type, with its name above and a note below.

    Args:
        name: name of the quantity.
        value: text of the value.
        note: text below the value; empty for none.
        attributes: further HTML attributes, with a space before them.
    """
    below = f"<small>{escape(note)}</small>" if note else ""
    return f"<div class='key'{attributes}><span>{escape(name)}</span><strong>{escape(value)}</strong>{below}</div>"


def widget_html(widget: Widget) -> str:
    """HTML of an interactive figure: its controls, and an empty element in which the page's script draws."""
    return f"{widget.html}<div class='chart' style='height: {widget.height}px'></div><p class='caption'></p>"


def tabs_html(tabs: Mapping[str, str], anchor: str) -> str:
    """HTML of radio buttons that choose the channel that all sections show; empty for fewer than two channels.

    Args:
        tabs: text of each button, by channel.
        anchor: HTML id of the section.
    """
    return radio_buttons_html(
        "tabs", "Show", f"tab-{anchor}", {f"data-tab='{escape(name)}'": text for name, text in tabs.items()}
    )


def radio_buttons_html(kind: str, legend: str, name: str, options: Mapping[str, str]) -> str:
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


MAX_ROUNDING_SHARE_OF_ARRAY_RANGE = 1e-5
"""Largest rounding error of a drawn value, as a share of its array's range; a screen shows less."""


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
    if finite.size == 0 or np.spacing(np.float32(np.abs(finite).max())) > MAX_ROUNDING_SHARE_OF_ARRAY_RANGE * np.ptp(
        finite
    ):
        return value
    return {**value, "dtype": "f4", "bdata": base64.b64encode(array.astype("<f4").tobytes()).decode()}


def template_text(package: str, name: str) -> str:
    """Text of an HTML, CSS or JavaScript file in the folder ``templates`` of a package of `pipeline`.

    Args:
        package: name of the package, such as ``"report"``.
        name: name of the file, such as ``"page.js"``.
    """
    return (Path(__file__).parents[1] / package / "templates" / name).read_text(encoding="utf-8")


PLOTLY_LOOK = {"template": PLOTLY_TEMPLATE, "dark": DARK_COLOURS}
"""Style of all figures of a page, as data for its script."""


def page_head_html(title: str, style: str = "") -> str:
    """HTML head of a page, whose content security policy forbids to load anything from the network.

    Args:
        title: title of the page.
        style: CSS after the common style sheet.
    """
    style = template_text("report", "style.css") + style
    return Template(template_text("report", "head.html")).substitute(title=escape(title), style=style)


@cache
def _library() -> str:
    from plotly.offline import get_plotlyjs

    return gzip_base64(get_plotlyjs())


def gzip_base64(text: str) -> str:
    """Text compressed with gzip, in base64; browsers since 2023 can decompress it."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
