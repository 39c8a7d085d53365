"""One offline HTML page: sections with figures and tables, a verdict, key figures, and plotly.js once."""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn import __version__, atomic
from armdyn.quoting import script_json
from pipeline.report.theme import DARK, TEMPLATE

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True)
class Chart:
    """A figure with what it shows.

    Attributes:
        figure: made with the roles of `pipeline.report.theme`; it needs no title and no template.
        caption: a sentence under it.
        tab: the tab of its section under which it stands; empty where it is always shown.
    """

    figure: "go.Figure"
    caption: str = ""
    tab: str = ""


@dataclass(frozen=True)
class Widget:
    """A figure that the page's script draws from data as a reader clicks.

    Attributes:
        html: its controls.
        data: for the script.
        height: of the figure [px].
    """

    html: str
    data: Mapping[str, Any]
    height: int


@dataclass(frozen=True)
class Table:
    """Rows of text.

    Attributes:
        header: name of each column.
        rows: one text per column; a column whose cells are all numbers is set to the right.
        caption: a sentence under it.
        shares: per row, the share that is drawn as a bar behind the last cell, 1 = full; empty for no bars.
        bars: the same for other columns, by their number, without a colour that judges.
        folded: where given, the table is behind a line with this text.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    shares: Sequence[float] = ()
    bars: Mapping[int, Sequence[float]] = field(default_factory=dict)
    folded: str = ""

    def html(self) -> str:
        """The table as HTML, every text escaped."""
        right = [all(_is_number(row[i]) for row in self.rows) for i in range(len(self.header))]
        right[-1] = right[-1] and not self.shares
        right = [number and i not in self.bars for i, number in enumerate(right)]
        head = "".join(_cell("th", text, number) for text, number in zip(self.header, right, strict=True))
        body = []
        for i, row in enumerate(self.rows):
            cells = [_cell("td", text, number) for text, number in zip(row, right, strict=True)]
            if self.shares:
                cells[-1] = _bar(row[-1], self.shares[i])
            for column, shares in self.bars.items():
                cells[column] = _bar(row[column], shares[i], judged=False)
            body.append(f"<tr>{''.join(cells)}</tr>")
        caption = f"<p class='caption'>{escape(self.caption)}</p>" if self.caption else ""
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
        shown = f"<div class='table'>{table}</div>{caption}"
        return f"<details><summary>{escape(self.folded)}</summary>{shown}</details>" if self.folded else shown


@dataclass(frozen=True)
class Section:
    """One part of the page.

    Attributes:
        title: heading, and the entry in the navigation.
        sentence: what a person should take from it.
        charts: its figures.
        tables: below them.
        tabs: labels by name of a tab; all sections show the tab that was chosen in one of them.
        widget: a figure to click through.
    """

    title: str
    sentence: str = ""
    charts: Sequence[Chart] = ()
    tables: Sequence[Table] = ()
    tabs: Mapping[str, str] = field(default_factory=dict)
    widget: Widget | None = None

    @property
    def anchor(self) -> str:
        """Name of the section in the page's address."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


def _is_number(text: str) -> bool:
    return not text or text[0].isdigit() or text[0] in "-–−+±<"


LONG = 40
"""Characters of a cell that needs room, so that it does not become a tower of single words on a narrow screen."""


def _cell(tag: str, text: str, number: bool) -> str:
    kind = " class=number" if number else " class=words" if tag == "td" and len(text) > LONG else ""
    return f"<{tag}{kind}>{escape(text)}</{tag}>"


def _bar(text: str, share: float, *, judged: bool = True) -> str:
    kind = "fine" if not judged else "over" if share > 1.0 else "close" if share > 0.9 else "fine"
    width = 100 * min(max(share, 0.0), 1.0)
    return f"<td class='share {kind}'><span style='width: {width:.1f}%'></span><b>{escape(text)}</b></td>"


_TEMPLATES = Path(__file__).parent / "templates"


class Level(Enum):
    """Colour of the verdict; the value is the word that goes with it for those who see no colours."""

    GOOD = "done"
    IMPROVED = "improved"
    CAUTION = "caution"
    BAD = "failed"


@dataclass(frozen=True)
class KeyFigure:
    """A number in large type.

    Attributes:
        name: what it is.
        value: with its unit.
        note: what to compare it with.
    """

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class NextStep:
    """What a reader may want to do now.

    Attributes:
        what: in a few words.
        command: to be copied.
    """

    what: str
    command: str


@dataclass(frozen=True)
class Report:
    """One HTML file.

    Attributes:
        title: heading.
        level: colour of the banner.
        verdict: the sentence in it.
        sections: in reading order.
        subtitle: what was run.
        key_figures: under the banner.
        notes: sentences that a reader must know before the sections, such as a warning.
        command: how to make this report again.
        next_steps: what to do now, each with the command that does it.
    """

    title: str
    level: Level
    verdict: str
    sections: Sequence[Section]
    subtitle: str = ""
    key_figures: Sequence[KeyFigure] = ()
    notes: Sequence[str] = ()
    command: str = ""
    next_steps: Sequence[NextStep] = ()

    def html(self) -> str:
        """The whole page."""
        figures: list[dict[str, Any]] = []
        widgets: list[Mapping[str, Any]] = []
        sections = "".join(_section(section, figures, widgets) for section in self.sections)
        return _template("page.html").substitute(
            head=page_head(self.title),
            title=escape(self.title),
            subtitle=escape(self.subtitle),
            level=self.level.name.lower(),
            word=escape(self.level.value),
            verdict=escape(self.verdict),
            navigation="".join(f"<a href='#{s.anchor}'>{escape(s.title)}</a>" for s in self.sections),
            key_figures="".join(map(_key_figure, self.key_figures)),
            notes="".join(f"<p class='note'>{escape(note)}</p>" for note in self.notes),
            next_steps="".join(map(_next_step, self.next_steps)),
            sections=sections,
            footer=escape(f"armdyn {__version__}" + (f" · {self.command}" if self.command else "")),
            script=_template("page.js").template,
            draw=_template("draw.js").template,
            overlay=_template("overlay.js").template,
            look=script_json(LOOK),
            data=packed(script_json({"figures": figures, "widgets": widgets})),
            plotly=_library(),
        )

    def write(self, path: Path | str) -> None:
        """Write the page in one step.

        Raises:
            InputError: the file cannot be written.
        """
        atomic.write_text(Path(path), self.html())


def _section(section: Section, figures: list[dict[str, Any]], widgets: list[Mapping[str, Any]]) -> str:
    """HTML of a section; what the script shall draw is appended to `figures` and `widgets`."""
    heading = f"<h2>{escape(section.title)}</h2>"
    if section.sentence:
        heading += f"<p class='sentence'>{escape(section.sentence)}</p>"
    heading += tabs_html(section.tabs, section.anchor)
    widget = section.widget
    if widget is not None:
        place = f"<div class='chart' style='height: {widget.height}px'></div><p class='caption'></p>"
        heading += f"<form class='widget' id='widget-{len(widgets)}'>{widget.html}{place}</form>"
        widgets.append(widget.data)
    charts = [_chart(chart, figures) for chart in section.charts]
    # On paper the heading stays with the first figure.
    together = f"<div class='together'>{heading}{''.join(charts[:1])}</div>"
    tables = "".join(table.html() for table in section.tables)
    return f"<section id='{section.anchor}'>{together}{''.join(charts[1:])}{tables}</section>"


def tabs_html(tabs: Mapping[str, str], anchor: str) -> str:
    """Radio buttons that choose what is shown, in this and in other sections; none where there is nothing to choose."""
    if len(tabs) < 2:
        return ""
    buttons = "".join(
        f"<label><input type='radio' name='tab-{anchor}' data-tab='{escape(name)}'><span>{escape(label)}</span></label>"
        for name, label in tabs.items()
    )
    return f"<fieldset class='pills tabs'><legend>Show</legend>{buttons}</fieldset>"


def _chart(chart: Chart, figures: list[dict[str, Any]]) -> str:
    figure = _light(json.loads(chart.figure.to_json()))
    figure["layout"].pop("template", None)
    height = figure["layout"].get("height", 360)
    place = f"<div class='chart' id='chart-{len(figures)}' style='height: {height}px'></div>"
    if (figure["layout"].get("meta") or {}).get("wide"):
        place = f"<div class='wide'>{place}</div>"
    figures.append({"data": figure["data"], "layout": figure["layout"]})
    html = place + (f"<p class='caption'>{escape(chart.caption)}</p>" if chart.caption else "")
    return f"<div data-of='{escape(chart.tab)}'>{html}</div>" if chart.tab else html


PRECISE = 1e-5
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
    if finite.size == 0 or np.spacing(np.float32(np.abs(finite).max())) > PRECISE * np.ptp(finite):
        return value
    return {**value, "dtype": "f4", "bdata": base64.b64encode(array.astype("<f4").tobytes()).decode()}


def _next_step(step: NextStep) -> str:
    return f"<p class='next'>{escape(step.what)}<code>{escape(step.command)}</code></p>"


def _key_figure(figure: KeyFigure) -> str:
    note = f"<small>{escape(figure.note)}</small>" if figure.note else ""
    return f"<div class='key'><span>{escape(figure.name)}</span><strong>{escape(figure.value)}</strong>{note}</div>"


def _template(name: str) -> Template:
    return Template((_TEMPLATES / name).read_text(encoding="utf-8"))


LOOK = {"template": TEMPLATE, "dark": DARK}


def widget_scripts() -> tuple[str, ...]:
    """Scripts that draw a `Widget` on a page that has plotly.js; `LOOK` says in which colours."""
    return _template("draw.js").template, _template("overlay.js").template


def page_head(title: str, style: str = "") -> str:
    """Everything before the body of an offline page: nothing may be loaded from elsewhere."""
    return _template("head.html").substitute(title=escape(title), style=f"{report_style()}{style}")


def report_style() -> str:
    """Style sheet of every page."""
    return _template("style.css").template


@cache
def _library() -> str:
    from plotly.offline import get_plotlyjs

    return packed(get_plotlyjs())


def packed(text: str) -> str:
    """Text compressed for a page: gzip in base64, a quarter of the size; every browser since 2023 can read it."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
