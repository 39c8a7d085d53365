"""One offline HTML page: sections with figures and tables, a verdict, key figures, and plotly.js once."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, ClassVar

from armdyn import __version__, atomic
from pipeline.report.theme import TEMPLATE

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True)
class Chart:
    """A figure with what it shows.

    Attributes:
        figure: made with the roles of `pipeline.report.theme`; it needs no title and no template.
        caption: a sentence under it.
    """

    figure: "go.Figure"
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of text.

    Attributes:
        header: name of each column.
        rows: one text per column; a column whose cells are all numbers is set to the right.
        caption: a sentence under it.
        shares: per row, the share that is drawn as a bar behind the last cell, 1 = full; empty for no bars.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    shares: Sequence[float] = ()

    def html(self) -> str:
        """The table as HTML, every text escaped."""
        right = [all(_is_number(row[i]) for row in self.rows) for i in range(len(self.header))]
        right[-1] = right[-1] and not self.shares
        head = "".join(_cell("th", text, number) for text, number in zip(self.header, right, strict=True))
        body = []
        for i, row in enumerate(self.rows):
            cells = [_cell("td", text, number) for text, number in zip(row, right, strict=True)]
            if self.shares:
                cells[-1] = _bar(row[-1], self.shares[i])
            body.append(f"<tr>{''.join(cells)}</tr>")
        caption = f"<p class='caption'>{escape(self.caption)}</p>" if self.caption else ""
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
        return f"<div class='table'>{table}</div>{caption}"


class Section:
    """Base of all sections; a section overrides what it has.

    Attributes:
        title: heading, and the entry in the navigation.
    """

    title: ClassVar[str]

    @property
    def anchor(self) -> str:
        """Name of the section in the page's address."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())

    def sentence(self) -> str:
        """What a person should take from this section."""
        return ""

    def charts(self) -> Sequence[Chart]:
        """Its figures."""
        return ()

    def tables(self) -> Sequence[Table]:
        """Its tables."""
        return ()


def _is_number(text: str) -> bool:
    return not text or text[0].isdigit() or text[0] in "-–−+±<"


def _cell(tag: str, text: str, number: bool) -> str:
    return f"<{tag}{' class=number' if number else ''}>{escape(text)}</{tag}>"


def _bar(text: str, share: float) -> str:
    kind = "over" if share > 1.0 else "close" if share > 0.9 else "fine"
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
    """

    title: str
    level: Level
    verdict: str
    sections: Sequence[Section]
    subtitle: str = ""
    key_figures: Sequence[KeyFigure] = ()
    notes: Sequence[str] = ()
    command: str = ""

    def html(self) -> str:
        """The whole page."""
        from plotly.offline import get_plotlyjs

        figures: list[dict[str, Any]] = []
        sections = "".join(_section(section, figures) for section in self.sections)
        return _template("page.html").substitute(
            title=escape(self.title),
            subtitle=escape(self.subtitle),
            level=self.level.name.lower(),
            word=escape(self.level.value),
            verdict=escape(self.verdict),
            navigation="".join(f"<a href='#{s.anchor}'>{escape(s.title)}</a>" for s in self.sections),
            key_figures="".join(map(_key_figure, self.key_figures)),
            notes="".join(f"<p class='note'>{escape(note)}</p>" for note in self.notes),
            sections=sections,
            footer=escape(f"armdyn {__version__}" + (f" · {self.command}" if self.command else "")),
            style=_template("style.css").template,
            script=_template("page.js").template,
            template=_json(TEMPLATE),
            figures=_json(figures),
            plotly=get_plotlyjs().replace("</script", "<\\/script"),
        )

    def write(self, path: Path | str) -> None:
        """Write the page in one step.

        Raises:
            InputError: the file cannot be written.
        """
        atomic.write_text(Path(path), self.html())


def _section(section: Section, figures: list[dict[str, Any]]) -> str:
    """HTML of a section; the figures that the script shall draw are appended to `figures`."""
    heading = f"<h2>{escape(section.title)}</h2>"
    if section.sentence():
        heading += f"<p class='sentence'>{escape(section.sentence())}</p>"
    charts = [_chart(chart, figures) for chart in section.charts()]
    # On paper the heading stays with the first figure.
    together = f"<div class='together'>{heading}{''.join(charts[:1])}</div>"
    tables = "".join(table.html() for table in section.tables())
    return f"<section id='{section.anchor}'>{together}{''.join(charts[1:])}{tables}</section>"


def _chart(chart: Chart, figures: list[dict[str, Any]]) -> str:
    figure = json.loads(chart.figure.to_json())
    figure["layout"].pop("template", None)
    height = figure["layout"].get("height", 360)
    place = f"<div class='chart' id='chart-{len(figures)}' style='height: {height}px'></div>"
    figures.append({"data": figure["data"], "layout": figure["layout"]})
    return place + (f"<p class='caption'>{escape(chart.caption)}</p>" if chart.caption else "")


def _key_figure(figure: KeyFigure) -> str:
    note = f"<small>{escape(figure.note)}</small>" if figure.note else ""
    return f"<div class='key'><span>{escape(figure.name)}</span><strong>{escape(figure.value)}</strong>{note}</div>"


def _template(name: str) -> Template:
    return Template((_TEMPLATES / name).read_text(encoding="utf-8"))


def _json(value: object) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c").replace("\u2028", "\\u2028")
