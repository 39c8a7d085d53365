"""A section of a report: a title, a sentence, figures and tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, ClassVar

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
