"""The page around the sections: verdict, key figures, navigation, and plotly.js once, so that it works offline."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from armdyn import __version__, atomic
from pipeline.report.section import Chart, Section
from pipeline.report.theme import TEMPLATE

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
