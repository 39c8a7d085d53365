"""The candidates for the missing effect, and how much speaks for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import plotly.graph_objects as go

from armdyn.identify.suspects import Suspect
from pipeline.report.section import Chart, Section, Table
from pipeline.report.theme import BLUE, GREY, ORANGE


@dataclass(frozen=True)
class EvidenceSection(Section):
    """Evidence bars; what ties with the best has its colour."""

    title: ClassVar[str] = "Which effect is missing"

    suspects: Sequence[Suspect]
    remedies: Sequence[str] = ()

    def sentence(self) -> str:
        """Ties, and what would settle them."""
        if not self.suspects:
            return "Nothing in the catalogue makes a difference."
        best = self.suspects[0]
        if not best.tied_with:
            return f"{best.effect} explains most, and nothing ties with it."
        text = f"These runs cannot tell {best.effect} from {', '.join(best.tied_with)}."
        return text + (f" What would: {'; '.join(self.remedies)}." if self.remedies else "")

    def charts(self) -> Sequence[Chart]:
        """ΔBIC, best on top."""
        if not self.suspects:
            return ()
        best = self.suspects[0]
        names = [_label(s) for s in self.suspects]
        colours = [BLUE if s is best else ORANGE if s.effect in best.tied_with else GREY for s in self.suspects]
        figure = go.Figure(layout={"height": 120 + 34 * len(names), "showlegend": False})
        figure.add_bar(
            x=[max(s.delta_bic, 0.1) for s in self.suspects], y=names, orientation="h", marker={"color": colours}
        )
        figure.update_xaxes(title_text="ΔBIC (evidence, logarithmic)", type="log")
        figure.update_yaxes(autorange="reversed", automargin=True)
        return [Chart(figure, "Blue: the best. Orange: what these runs cannot tell from it.")]

    def tables(self) -> Sequence[Table]:
        """Errors with each, and its parameters."""
        rows = []
        for s in self.suspects:
            values = ", ".join(f"{n.partition('.')[2]} {p.value:.4g} {p.unit}" for n, p in s.parameters.items())
            held_out = ", ".join(f"{v:.4g}" for v in s.held_out_rmse.values()) or "–"
            rmse = ", ".join(f"{v:.4g}" for v in s.rmse.values())
            rows.append([_label(s), f"{s.delta_bic:.1f}", rmse, held_out, values])
        return [Table(["effect", "ΔBIC", "rms error", "held out", "parameters"], rows)] if rows else ()


def _label(suspect: Suspect) -> str:
    return f"{suspect.effect} ({', '.join(suspect.joints)})" if suspect.joints else suspect.effect
