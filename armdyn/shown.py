"""What every result can do in a notebook: show itself, plot itself, become a data frame. Loads nothing until asked."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armdyn.document import Document


class Displayable(ABC):
    """Base of what a notebook shows."""

    @abstractmethod
    def document(self) -> "Document":
        """Sentences, tables and curves: what there is to show."""

    def __repr__(self) -> str:
        """The sentence of it, not all of its samples."""
        return f"{type(self).__name__}: {self.document().verdict}"

    def _repr_html_(self) -> str:
        """A small card for a notebook, without scripts."""
        from armdyn.notebook import card

        return card(self.document())

    def plot(self) -> Any:
        """Measured and predicted over time, per channel, as a plotly figure; of several runs one at a time.

        Raises:
            InputError: plotly is missing, or there is nothing to plot: compare a model with runs, and plot that.
        """
        from armdyn.notebook import figure

        return figure(self.document())

    def to_dataframe(self, what: str = "") -> Any:
        """A table of this as a pandas data frame.

        Args:
            what: ``"parameters"``, ``"channels"``, ``"samples"`` or ``"missing_force"``; of a diagnosis also
                ``"candidates"``, of a repair also ``"steps"``, of a plan ``"experiments"``; a run has ``"samples"`` and
                ``"channels"``, a model ``"parameters"``. The first of what there is when it is not given.

        Raises:
            InputError: pandas is missing.
            UnknownNameError: there is no such table.
        """
        from armdyn.notebook import frame

        return frame(self.document(), what)
