"""The reports of a diagnosis and of a repair: the candidates, the error falling, the links."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.exam import Judge
from armdyn.identify.explained import Scale
from armdyn.identify.repair import Repair
from armdyn.identify.repair_step import RepairStep
from armdyn.identify.sentence import MOST_JOINTS, totals
from armdyn.identify.study import Study
from armdyn.identify.suspects import Suspect
from armdyn.identify.verdict import Verdict
from pipeline.report.fit import fit_sections, key_figures, runs_of
from pipeline.report.page import Chart, Level, Report, Section, Table
from pipeline.report.theme import BLUE, GREEN, GREY, ORANGE

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange


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


@dataclass(frozen=True)
class RepairPathSection(Section):
    """χ² per sample and the errors of every step, on training, held-out and exam runs."""

    title: ClassVar[str] = "The error falling"

    path: Sequence[RepairStep]
    scale: Scale
    judges: Sequence[Judge] = ()

    def sentence(self) -> str:
        """From where to where."""
        first, last = self.path[0], self.path[-1]
        fall = f"{first.chi2_per_sample:.4g} → {last.chi2_per_sample:.4g}"
        steps = len(self.path) - 1
        return f"χ² per sample {fall} in {steps} step{'' if steps == 1 else 's'}." if steps else "Nothing was added."

    def charts(self) -> Sequence[Chart]:
        """Root of the summed squared errors per step, against that of the model as given."""
        names = [step_name(step) for step in self.path]
        figure = go.Figure(layout={"height": 150 + 34 * len(names)})
        for name, colour, values in (
            ("training", BLUE, [step.rmse for step in self.path]),
            ("held out", ORANGE, [step.held_out_rmse for step in self.path]),
            ("exam", GREEN, [step.exam_rmse for step in self.path]),
        ):
            if not values[0]:
                continue
            sums = [totals(errors, self.scale.units) for errors in values]
            share = [float(np.sqrt(np.mean([(s[unit] / sums[0][unit]) ** 2 for unit in sums[0]]))) for s in sums]
            figure.add_scatter(
                x=share, y=names, mode="lines+markers", name=name, line={"color": colour, "shape": "vh", "width": 2}
            )
        figure.update_xaxes(title_text="rms error / error as given", type="log")
        figure.update_yaxes(automargin=True, autorange="reversed")
        several = len(set(self.scale.units.values())) > 1
        return [Chart(figure, "Several units: the root mean square of their shares." if several else "")]

    def tables(self) -> Sequence[Table]:
        """A row per step."""
        examined = bool(self.path[0].exam_rmse)
        rows = [
            [
                step_name(step),
                self._errors(step.rmse),
                self._errors(step.held_out_rmse),
                *([self._errors(step.exam_rmse)] if examined else []),
                f"{step.chi2_per_sample:.4g}",
                f"{step.bic:.1f}",
                ", ".join(step.tied_with),
            ]
            for step in self.path
        ]
        errors = [f"{name}{self._unit}" for name in ("rms error", "held out", *(["exam"] if examined else []))]
        caption = "; ".join(judge.value for judge in self.judges)
        if len(self.path[0].rmse) > len(set(self.scale.units.values())):
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


def step_name(step: RepairStep) -> str:
    """Such as ``+ quadratic_drag − linear_drag``."""
    parts = [f"+ {name}" for name in step.added]
    text = " ".join(parts) or "as given"
    if not step.joints:
        return text
    return f"{text} ({', '.join(step.joints) if len(step.joints) <= MOST_JOINTS else f'{len(step.joints)} joints'})"


NAMES = {"mass": "mass", "centre": "centre of mass", "inertia": "inertia", "moment": "mass times centre"}


@dataclass(frozen=True)
class LinkSection(Section):
    """What the repair did to the links, and which of it the runs determine."""

    title: ClassVar[str] = "Links"

    links: Sequence["LinkChange"]

    def sentence(self) -> str:
        """How much is determined, and what must not be overlooked."""
        every = [q for link in self.links for q in link.quantities]
        determined = sum(q.determined for q in every)
        text = f"These runs determine {determined} of {len(every)} values. "
        if determined < len(every):
            text += (
                "Torques tell sums over several links; a value of a single link that is not determined may be wrong "
                "although the torques are right. "
            )
        return text + " ".join(f"Look out: {link.warning}." for link in self.links if link.warning)

    def tables(self) -> Sequence[Table]:
        """A table per link."""
        return [self._table(link) for link in self.links]

    @staticmethod
    def _table(link: "LinkChange") -> Table:
        rows = []
        for q in link.quantities:
            kind, _, axis = q.name.partition("_")
            name = f"{NAMES[kind]} {axis}".strip()
            # Rounding leaves a tiny number where the exact value is zero.
            value = q.value if abs(q.value) > 1e-6 * max(q.std, abs(q.described)) else 0.0
            certain = "yes" if q.determined else "not by these runs"
            rows.append([name, f"{q.described:.4g}", f"{value:.4g}", f"{q.std:.2g}", q.unit, certain])
        caption = (
            f"The link that {link.joint} moves, with all that is fixed to it, in the frame of that joint; inertia "
        )
        return Table(
            [link.joint, "URDF", "repaired", "std", "unit", "determined"],
            rows,
            caption + "is about the centre of mass.",
        )


LEVELS = {
    Verdict.EXPLAINED: Level.GOOD,
    Verdict.EFFECT_MISSING: Level.CAUTION,
    Verdict.CANNOT_TELL_APART: Level.CAUTION,
    Verdict.UNKNOWN_EFFECT: Level.CAUTION,
}


def diagnosis_report(study: Study, found: Diagnosis, command: str = "") -> Report:
    """The candidates with their evidence, then the fit as it is."""
    return Report(
        title="Diagnose: which effect is missing",
        level=LEVELS[found.verdict],
        verdict=found.sentence,
        sections=[EvidenceSection(found.suspects, found.remedies), *fit_sections(found.comparison)],
        subtitle=runs_of(study),
        key_figures=key_figures(found.comparison),
        command=command,
    )


MUCH = 0.5
"""Share of the misfit; a repair that explains more is an improvement, whatever it leaves."""


def repair_level(found: Repair) -> Level:
    """Done where only noise is left, improved where much is explained, failed only where the error grew."""
    if found.verdict is Verdict.EXPLAINED and found.after.widened == 1.0:
        return Level.GOOD
    if found.explained < 0.0:
        return Level.BAD
    return Level.IMPROVED if found.explained > MUCH else Level.CAUTION


def repair_report(study: Study, found: Repair, command: str = "") -> Report:
    """The error falling, what became of an arm's links, then the repaired fit."""
    links = [LinkSection(found.links)] if found.links else []
    return Report(
        title="Repair: add what is missing, watch the error fall",
        level=repair_level(found),
        verdict=found.sentence,
        sections=[RepairPathSection(found.steps, found.after.scale, study.judges), *links, *fit_sections(found.after)],
        subtitle=runs_of(study),
        key_figures=key_figures(found.after),
        command=command,
    )
