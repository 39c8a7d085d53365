"""What there is to show of a result: sentences, tables, figures. Terminal, page and notebook render the same document.

Nothing here knows how it looks: `armdyn.notebook` makes cards, data frames and figures of it, `pipeline.console.screen`
prints it, `pipeline.report.page` makes one HTML file.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from armdyn.recording.channels import FloatArray

MAX_CARD_ROWS = 15
"""Of a table in a card, and on a terminal where the table has no name; pages and data frames have all."""
Columns = Mapping[str, Sequence[Any]]
"""Values by name of their column."""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: in a data frame, and, with spaces in place of underscores, above the column.
        values: of any kind, None where there is none.
        form: format of numbers that are not whole.
        missing: what is shown for None.
        shares: per value, the share that is drawn as a bar behind it, 1 = full; empty for no bars.
        judged: colour the bars by how full they are.
        wide: leave the column out where a table must be narrow, on a terminal and in a card.
        title: what stands above it; its name with spaces in place of underscores when empty.
    """

    name: str
    values: Sequence[Any]
    form: str = ".4g"
    missing: str = "–"
    shares: Sequence[float] = ()
    judged: bool = False
    wide: bool = False
    title: str = ""

    @property
    def heading(self) -> str:
        """What stands above it."""
        return self.title or self.name.replace("_", " ")

    @property
    def texts(self) -> list[str]:
        """A text per value."""
        return [self._text(value) for value in self.values]

    def _text(self, value: Any) -> str:
        if value is None:
            return self.missing
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, list | tuple):
            return ", ".join(map(str, value))
        return format(value, self.form) if isinstance(value, float) else str(value)


def columns_of(items: Collection[Any], **forms: str) -> list[Column]:
    """A column per attribute of the items, by its name, with the format of its numbers."""
    return [Column(name, [getattr(item, name) for item in items], form) for name, form in forms.items()]


@dataclass(frozen=True)
class Table:
    """Columns of equal length.

    Attributes:
        columns: from left to right.
        caption: a sentence under it.
        name: by which a data frame of it is asked for; empty where nobody asks.
        folded: where given, a page shows the table behind a line with this text.
    """

    columns: Sequence[Column]
    caption: str = ""
    name: str = ""
    folded: str = ""

    @classmethod
    def of(cls, header: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = "") -> "Table":
        """A table of rows, with a value per column."""
        return cls([Column(name, [row[i] for row in rows]) for i, name in enumerate(header)], caption)

    @property
    def values(self) -> Columns:
        """By name of the column."""
        return {column.name: column.values for column in self.columns}

    @property
    def filled(self) -> list[Column]:
        """The columns in which something stands."""
        return [c for c in self.columns if any(value not in (None, "", (), []) for value in c.values)]

    @property
    def narrow(self) -> list[Column]:
        """Those of a table that must be narrow."""
        return [column for column in self.filled if not column.wide]

    def __len__(self) -> int:
        return len(self.columns[0].values) if self.columns else 0


@dataclass(frozen=True)
class Chart:
    """A figure with what it shows.

    Attributes:
        figure: of plotly, or its data and layout; made with the roles of `pipeline.report.theme`, it needs no title
            and no template.
        caption: a sentence under it.
        tab: the tab of its section under which it stands; empty where it is always shown.
    """

    figure: "go.Figure | Mapping[str, Any]"
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
class Section:
    """One part of a document.

    Attributes:
        title: heading, and the entry in the navigation of a page.
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
        """Name of the section in a page's address."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


class Level(Enum):
    """How good the news is; the value is the word that goes with it for those who see no colours."""

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


@dataclass(frozen=True, eq=False)
class Curve:
    """A line, or points, of a figure over time.

    Attributes:
        row: the panel in which it is drawn, and the title of its axis.
        label: what it is; curves of one label have one colour.
        time: (n,) s.
        value: (n,) in the unit of the row.
        run: of several runs one is shown at a time.
        dots: measured samples, not a line.
        half_width: (n,) of a band around it; None for none.
    """

    row: str
    label: str
    time: "FloatArray"
    value: "FloatArray"
    run: str = ""
    dots: bool = False
    half_width: "FloatArray | None" = None


@dataclass(frozen=True)
class Document:
    """What there is to show of a result.

    Attributes:
        title: what it is.
        verdict: the sentence that a person reads first.
        sections: in reading order.
        level: how good the news is; None where that is no question.
        subtitle: what was run.
        key_figures: numbers in large type.
        notes: sentences that a reader must know, such as a warning.
        next_steps: what to do now, each with the command that does it.
        command: how to make this document again.
        data: what is too long for a table, by name; made when a data frame of it is asked for.
        curves: what to plot; None where there is nothing.
        default: name of the table whose data frame is made when none is asked for; the first one's when empty.
    """

    title: str
    verdict: str
    sections: Sequence[Section] = ()
    level: Level | None = None
    subtitle: str = ""
    key_figures: Sequence[KeyFigure] = ()
    notes: Sequence[str] = ()
    next_steps: Sequence[NextStep] = ()
    command: str = ""
    data: Mapping[str, Callable[[], Columns]] = field(default_factory=dict)
    curves: Callable[[], Iterable[Curve]] | None = None
    default: str = ""

    @property
    def tables(self) -> list[Table]:
        """Of all sections."""
        return [table for section in self.sections for table in section.tables]

    def section(self, title: str) -> Section:
        """The section of this title."""
        return next(section for section in self.sections if section.title == title)
