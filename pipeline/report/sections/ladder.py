"""The error falling as effects are added."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.exam import Judge
from armdyn.identify.explained import Scale
from armdyn.identify.rung import Rung
from armdyn.identify.sentence import MOST_JOINTS, totals
from pipeline.report.section import Chart, Section, Table
from pipeline.report.theme import BLUE, GREEN, ORANGE


@dataclass(frozen=True)
class LadderSection(Section):
    """χ² per sample and the errors of every step, on training, held-out and exam runs."""

    title: ClassVar[str] = "The error falling"

    ladder: Sequence[Rung]
    scale: Scale
    judges: Sequence[Judge] = ()

    def sentence(self) -> str:
        """From where to where."""
        first, last = self.ladder[0], self.ladder[-1]
        fall = f"{first.chi2_per_sample:.4g} → {last.chi2_per_sample:.4g}"
        steps = len(self.ladder) - 1
        return f"χ² per sample {fall} in {steps} step{'' if steps == 1 else 's'}." if steps else "Nothing was added."

    def charts(self) -> Sequence[Chart]:
        """Root of the summed squared errors per step, against that of the model as given."""
        steps = [step_name(rung) for rung in self.ladder]
        figure = go.Figure(layout={"height": 150 + 34 * len(steps)})
        for name, colour, values in (
            ("training", BLUE, [rung.rmse for rung in self.ladder]),
            ("held out", ORANGE, [rung.held_out_rmse for rung in self.ladder]),
            ("exam", GREEN, [rung.exam_rmse for rung in self.ladder]),
        ):
            if not values[0]:
                continue
            sums = [totals(errors, self.scale.units) for errors in values]
            share = [float(np.sqrt(np.mean([(s[unit] / sums[0][unit]) ** 2 for unit in sums[0]]))) for s in sums]
            figure.add_scatter(
                x=share, y=steps, mode="lines+markers", name=name, line={"color": colour, "shape": "vh", "width": 2}
            )
        figure.update_xaxes(title_text="rms error / error as given", type="log")
        figure.update_yaxes(automargin=True, autorange="reversed")
        several = len(set(self.scale.units.values())) > 1
        return [Chart(figure, "Several units: the root mean square of their shares." if several else "")]

    def tables(self) -> Sequence[Table]:
        """A row per step."""
        examined = bool(self.ladder[0].exam_rmse)
        rows = [
            [
                step_name(rung),
                self._errors(rung.rmse),
                self._errors(rung.held_out_rmse),
                *([self._errors(rung.exam_rmse)] if examined else []),
                f"{rung.chi2_per_sample:.4g}",
                f"{rung.bic:.1f}",
                ", ".join(rung.tied_with),
            ]
            for rung in self.ladder
        ]
        errors = [f"{name}{self._unit}" for name in ("rms error", "held out", *(["exam"] if examined else []))]
        caption = "; ".join(judge.value for judge in self.judges)
        if len(self.ladder[0].rmse) > len(set(self.scale.units.values())):
            caption = f"errors: root of the channels' summed squares; {caption}"
        header = ["step", *errors, "χ² per sample", "BIC", "cannot be told from"]
        return [Table(header, rows, f"{caption[:1].upper()}{caption[1:]}." if caption else "")]

    def _errors(self, rmse: Mapping[str, float]) -> str:
        """In the header's unit, or each with its own."""
        sums = totals(rmse, self.scale.units)
        return ", ".join(f"{v:.4g}" if self._unit else f"{v:.4g} {unit}" for unit, v in sums.items()) or "–"

    @property
    def _unit(self) -> str:
        """Of all errors, for a header; empty where channels differ."""
        units = set(self.scale.units.values())
        return f" [{units.pop()}]" if len(units) == 1 else ""


def step_name(rung: Rung) -> str:
    """Such as ``+ quadratic_drag − linear_drag``."""
    parts = [f"+ {name}" for name in rung.added] + [f"− {name}" for name in rung.removed]
    text = " ".join(parts) or "as given"
    if not rung.joints:
        return text
    return f"{text} ({', '.join(rung.joints) if len(rung.joints) <= MOST_JOINTS else f'{len(rung.joints)} joints'})"
