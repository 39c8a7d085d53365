"""Base of results that a notebook can show, plot and turn into a data frame; nothing is loaded before it is needed."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armdyn.document import Document


class Displayable(ABC):
    """Base class of results that a notebook can show, plot and convert to a data frame."""

    @abstractmethod
    def document(self) -> "Document":
        """Build the document: sentences, tables and curves of the result."""

    def __repr__(self) -> str:
        """The result's sentence, instead of all of its samples."""
        return f"{type(self).__name__}: {self.document().verdict}"

    def _repr_html_(self) -> str:
        """HTML without scripts, which a notebook shows for the result."""
        from armdyn.notebook import html_card

        return html_card(self.document())

    def plot(self) -> Any:
        """Plot measured and predicted channels over time as a plotly figure; of several runs one is visible at a time.

        Raises:
            InputError: plotly is missing, or there is nothing to plot: compare a model with runs, and plot that.
        """
        from armdyn.notebook import plotly_figure

        return plotly_figure(self.document())

    def to_dataframe(self, what: str = "") -> Any:
        """Convert a table of the result to a pandas data frame.

        Args:
            what: name of the table: ``"parameters"``, ``"channels"``, ``"samples"`` or ``"missing_force"``; for a
                diagnosis also ``"candidates"``, for a repair also ``"steps"``, for a plan ``"experiments"``. A run has
                ``"samples"`` and ``"channels"``, a model has ``"parameters"``. By default the first of them.

        Raises:
            InputError: pandas is missing.
            UnknownNameError: there is no such table.
        """
        from armdyn.notebook import data_frame

        return data_frame(self.document(), what)
