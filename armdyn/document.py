"""Documents: the sentences, tables and figures of a result, which a terminal, an HTML page and a notebook can show.

A document has no layout: `armdyn.notebook` renders it as cards, data frames and figures, `pipeline.console.screen`
prints it, and `pipeline.report.page` writes one HTML file.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from armdyn.recording.channels import FloatArray

MAX_CARD_ROWS = 15
"""Largest number of rows of a table in a card, and of an unnamed table on a terminal; pages and data frames have all
rows."""
Columns = Mapping[str, Sequence[Any]]
"""Values of a table by column name."""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: name in a data frame, and, with spaces in place of underscores, the heading.
        values: values of any type, None where there is none.
        number_format: format of numbers that are not integers.
        missing_text: text for None.
        bar_lengths: length of the bar behind each value, 1 = full; empty for no bars.
        bar_coloured_by_length: whether the colour of a bar depends on its length.
        dropped_when_narrow: whether narrow tables, on a terminal and in a notebook's card, leave the column out.
        title: heading of the column; where empty, its name with spaces in place of underscores.
    """

    name: str
    values: Sequence[Any]
    number_format: str = ".4g"
    missing_text: str = "–"
    bar_lengths: Sequence[float] = ()
    bar_coloured_by_length: bool = False
    dropped_when_narrow: bool = False
    title: str = ""

    @property
    def heading(self) -> str:
        """Heading of the column."""
        return self.title or self.name.replace("_", " ")

    @property
    def texts(self) -> list[str]:
        """The values as texts."""
        return [self._text(value) for value in self.values]

    def _text(self, value: Any) -> str:
        if value is None:
            return self.missing_text
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, list | tuple):
            return ", ".join(map(str, value))
        return format(value, self.number_format) if isinstance(value, float) else str(value)


def attribute_columns(items: Collection[Any], **forms: str) -> list[Column]:
    """Make table columns from items: one column for each attribute named in `forms`, with its number format."""
    return [Column(name, [getattr(item, name) for item in items], form) for name, form in forms.items()]


@dataclass(frozen=True)
class Table:
    """A table: columns of equal length.

    Attributes:
        columns: from left to right.
        caption: a sentence below the table.
        name: name under which a data frame of the table is available; empty for none.
        fold_label: text of the line behind which a page hides the table; empty for a visible table.
    """

    columns: Sequence[Column]
    caption: str = ""
    name: str = ""
    fold_label: str = ""

    @classmethod
    def of(cls, header: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = "") -> "Table":
        """Make a table from rows with a value per column."""
        return cls([Column(name, [row[i] for row in rows]) for i, name in enumerate(header)], caption)

    @property
    def values(self) -> Columns:
        """Values by column name."""
        return {column.name: column.values for column in self.columns}

    @property
    def nonempty_columns(self) -> list[Column]:
        """Columns that contain at least one value."""
        return [c for c in self.columns if any(value not in (None, "", (), []) for value in c.values)]

    @property
    def columns_kept_when_narrow(self) -> list[Column]:
        """Columns that are kept where the table must be narrow."""
        return [column for column in self.nonempty_columns if not column.dropped_when_narrow]

    def __len__(self) -> int:
        return len(self.columns[0].values) if self.columns else 0


@dataclass(frozen=True)
class Chart:
    """A figure with its caption.

    Attributes:
        figure: a plotly figure, or its data and layout; with the roles of `pipeline.report.theme` it needs no title and
            no template.
        caption: a sentence below the figure.
        tab: label of the tab of its section in which it is shown; empty where it is always visible.
    """

    figure: "go.Figure | Mapping[str, Any]"
    caption: str = ""
    tab: str = ""


@dataclass(frozen=True)
class Widget:
    """An interactive figure that the page's script draws from data.

    Attributes:
        html: HTML of its controls.
        data: data for the script.
        height: height of the figure [px].
    """

    html: str
    data: Mapping[str, Any]
    height: int


@dataclass(frozen=True)
class Section:
    """One part of a document, with a heading, a sentence, figures and tables.

    Attributes:
        title: heading, and the entry in the navigation of a page.
        sentence: the main result of the section.
        charts: figures of the section.
        tables: tables below the figures.
        tabs: labels by name of a tab; choosing a tab selects it in all sections.
        widget: an interactive figure.
    """

    title: str
    sentence: str = ""
    charts: Sequence[Chart] = ()
    tables: Sequence[Table] = ()
    tabs: Mapping[str, str] = field(default_factory=dict)
    widget: Widget | None = None

    @property
    def anchor(self) -> str:
        """Identifier of the section in a page's address."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


class ResultLevel(Enum):
    """How good a result is, which decides its colour; the value is a word for readers who see no colours."""

    GOOD = "done"
    IMPROVED = "improved"
    CAUTION = "caution"
    BAD = "failed"


@dataclass(frozen=True)
class KeyFigure:
    """A number that a document shows in large type.

    Attributes:
        name: name of the number.
        value: the number with its unit.
        note: a value to compare it with.
    """

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class NextStep:
    """A step that a report suggests to its reader, with the command to run.

    Attributes:
        what: the step in a few words.
        command: command line to copy.
    """

    what: str
    command: str


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a figure over time, drawn as a line or as points.

    Attributes:
        panel: panel in which it is drawn, and title of its axis.
        label: label of the curve; curves with the same label have the same colour.
        time: (n,) times, s.
        value: (n,) values in the unit of the row.
        run: name of the run; of several runs one is visible at a time.
        drawn_as_points: whether it consists of measured samples instead of a line.
        half_width: (n,) half the width of a band around it; None for no band.
    """

    panel: str
    label: str
    time: "FloatArray"
    value: "FloatArray"
    run: str = ""
    drawn_as_points: bool = False
    half_width: "FloatArray | None" = None


@dataclass(frozen=True)
class Document:
    """A result for a reader: title, main sentence, sections with figures and tables, and next steps.

    Attributes:
        title: title of the document.
        verdict: the first sentence for a reader.
        sections: sections in reading order.
        level: how good the result is; None where that has no meaning.
        subtitle: the command or input of the result.
        key_figures: numbers in large type.
        notes: sentences that a reader must know, such as warnings.
        next_steps: next steps, each with its command.
        command: command that makes this document again.
        data: long tables by name; they are computed when a data frame of one is requested.
        curves: curves to plot; None where there are none.
        default_table: name of the table for the default data frame; where empty, the first one.
    """

    title: str
    verdict: str
    sections: Sequence[Section] = ()
    level: ResultLevel | None = None
    subtitle: str = ""
    key_figures: Sequence[KeyFigure] = ()
    notes: Sequence[str] = ()
    next_steps: Sequence[NextStep] = ()
    command: str = ""
    data: Mapping[str, Callable[[], Columns]] = field(default_factory=dict)
    curves: Callable[[], Iterable[Curve]] | None = None
    default_table: str = ""

    @property
    def tables(self) -> list[Table]:
        """Tables of all sections."""
        return [table for section in self.sections for table in section.tables]

    def section(self, title: str) -> Section:
        """The first section of the document with this title."""
        return next(section for section in self.sections if section.title == title)
