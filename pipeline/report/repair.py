"""The reports of a diagnosis and of a repair: the candidates, the error falling, the links."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.explained import RepairStep, Scale, in_percent
from armdyn.identify.repair import Repair
from armdyn.identify.search import repair_step
from armdyn.identify.sentence import MOST_EFFECTS, MOST_JOINTS, WHOSE, Verdict, added_effects, totals
from armdyn.identify.study import Study
from armdyn.identify.suspects import Suspect
from armdyn.identify.unseen import Judge
from pipeline.report.fit import fit_sections, key_figures, runs_of
from pipeline.report.missing_force import missing_force_sections
from pipeline.report.overlay import Overlays
from pipeline.report.page import KeyFigure, Level, NextStep, Report, Section, Table

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange


def evidence_section(
    suspects: Sequence[Suspect],
    remedies: Sequence[str],
    given: Mapping[str, float],
    scale: Scale,
    summaries: Mapping[str, str],
) -> Section:
    """What every effect would leave of the error, if it alone were added; the evidence behind a line.

    Args:
        suspects: best first.
        remedies: what would settle a tie.
        given: by channel, the error of the model as given.
        scale: units of the channels.
        summaries: what every effect is.
    """
    title = "Which effect is missing"
    if not suspects:
        return Section(title, "Nothing in the catalogue makes a difference.")
    best = suspects[0]
    text = f"{best.effect} explains most, and nothing ties with it."
    if best.tied_with:
        text = f"These runs cannot tell {best.effect} from {', '.join(best.tied_with)}."
        text += f" What would: {'; '.join(remedies)}." if remedies else ""
    held_out = any(s.held_out_rmse for s in suspects)
    rows, shares = [["as given", "", _sizes(given, scale), *(["–"] if held_out else []), ""]], [1.0]
    for s in suspects:
        values = ", ".join(f"{n.partition('.')[2]} {p.value:.4g} {p.unit}" for n, p in s.parameters.items())
        if len(s.joints) > MOST_JOINTS:
            values = f"{len(s.parameters)} values"
        unseen = [_sizes(s.held_out_rmse, scale)] if held_out else []
        rows.append([_label(s), summaries.get(s.effect, ""), _sizes(s.rmse, scale), *unseen, values])
        shares.append(relative(s.rmse, given, scale))
    header = ["with this effect alone", "what it is", "error", *(["held out"] if held_out else []), "its values"]
    caption = "Error: root mean square over the fitted runs" + (
        "; of several joints the root of their summed squares." if len(given) > 1 else "."
    )
    evidence = [[_label(s), f"{s.delta_bic:.1f}", f"{s.p_value:.1e}", ", ".join(s.tied_with)] for s in suspects]
    tables = [
        Table(header, rows, caption, bars={2: shares}),
        Table(
            ["effect", "ΔBIC", "p of chance", "cannot be told from"],
            evidence,
            "ΔBIC: evidence for the effect; 10 is strong, and counts only where what is left is noise.",
            folded="Statistics: evidence",
        ),
    ]
    return Section(title, text, tables=tables)


def _sizes(rmse: Mapping[str, float], scale: Scale) -> str:
    return ", ".join(f"{v:.4g} {unit}" for unit, v in totals(rmse, scale.units).items()) or "–"


def relative(rmse: Mapping[str, float], given: Mapping[str, float], scale: Scale) -> float:
    """Error over that of the model as given; of several units the root mean square of the ratios; 0 without errors."""
    now, before = totals(rmse, scale.units), totals(given, scale.units)
    ratios = [now[unit] / before[unit] for unit in now if before.get(unit)]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 0.0


def _label(suspect: Suspect) -> str:
    return f"{suspect.effect} ({_places(suspect.joints)})" if suspect.joints else suspect.effect


def _places(joints: Sequence[str]) -> str:
    return ", ".join(joints) if len(joints) <= MOST_JOINTS else f"{len(joints)} joints"


@dataclass(frozen=True)
class RepairPath:
    """The errors of every step, on training, held-out and exam runs."""

    path: Sequence[RepairStep]
    scale: Scale
    judges: Sequence[Judge] = ()
    summaries: Mapping[str, str] = field(default_factory=dict)

    def section(self) -> Section:
        """What a page shows of it."""
        return Section("The error falling", self._sentence(), tables=self._tables())

    def _sentence(self) -> str:
        """From where to where, on the most independent runs."""
        steps = len(self.path) - 1
        if not steps:
            return "Nothing was added."
        errors = next(kind for kind in (*reversed(self._kinds), "fitted") if self._of(self.path[0], kind))
        first, last = (self._errors(self._of(step, errors), whole=True) for step in (self.path[0], self.path[-1]))
        return f"{first} → {last} ({errors}) in {steps} step{'' if steps == 1 else 's'}."

    @property
    def _kinds(self) -> list[str]:
        given = self.path[0]
        others = {"held out": given.held_out_rmse, "exam": given.exam_rmse}
        return ["fitted", *(kind for kind, errors in others.items() if errors)]

    def _of(self, step: RepairStep, kind: str) -> Mapping[str, float]:
        return {"fitted": step.rmse, "held out": step.held_out_rmse, "exam": step.exam_rmse}[kind]

    def _tables(self) -> Sequence[Table]:
        """A row per step, the errors as bars; the statistics behind a line."""
        kinds, tied = self._kinds, any(step.tied_with for step in self.path)
        rows = [
            [
                step_name(step),
                *(self._errors(self._of(step, kind)) for kind in kinds),
                "; ".join(self.summaries.get(name, "") for name in step.added),
                *([", ".join(step.tied_with)] if tied else []),
            ]
            for step in self.path
        ]
        bars = {
            1 + i: [relative(self._of(step, kind), self._of(self.path[0], kind), self.scale) for step in self.path]
            for i, kind in enumerate(kinds)
        }
        caption = "; ".join(judge.value for judge in self.judges)
        if len(self.path[0].rmse) > len(set(self.scale.units.values())):
            caption = f"errors: root mean square, of several channels the root of their summed squares; {caption}"
        unseen = ["cannot be told from"] if tied else []
        header = ["step", *(f"{kind}{self._unit}" for kind in kinds), "what it is", *unseen]
        statistics = [[step_name(step), f"{step.chi2_per_sample:.4g}", f"{step.bic:.1f}"] for step in self.path]
        return [
            Table(header, rows, f"{caption[:1].upper()}{caption[1:]}." if caption else "", bars=bars),
            Table(
                ["step", "χ² per sample", "BIC"],
                statistics,
                "χ² per sample: squared error over squared noise, 1 where only noise is left.",
                folded="Statistics: χ² per sample, BIC",
            ),
        ]

    def _errors(self, rmse: Mapping[str, float], *, whole: bool = False) -> str:
        """In the header's unit, or each with its own."""
        sums, bare = totals(rmse, self.scale.units), self._unit and not whole
        return ", ".join(f"{v:.4g}" if bare else f"{v:.4g} {unit}" for unit, v in sums.items()) or "–"

    @property
    def _unit(self) -> str:
        """Of all errors, for a header; empty where channels differ."""
        units = set(self.scale.units.values())
        return f" [{units.pop()}]" if len(units) == 1 else ""


def step_name(step: RepairStep) -> str:
    """Such as ``+ quadratic_drag − linear_drag``."""
    parts = [f"+ {name}" for name in step.added]
    text = " ".join(parts) or "as given"
    return f"{text} ({_places(step.joints)})" if step.joints else text


NAMES = {"mass": "mass", "centre": "centre of mass", "inertia": "inertia", "moment": "mass times centre"}


def link_section(links: Sequence["LinkChange"]) -> Section:
    """What the repair did to the links, how much of it the runs determine, and what must not be overlooked."""
    every = [q for link in links for q in link.quantities]
    determined = sum(q.determined for q in every)
    text = f"These runs determine {determined} of {len(every)} values. "
    if determined < len(every):
        text += (
            "Torques tell sums over several links; a value of a single link that is not determined may be wrong "
            "although the torques are right. "
        )
    text += " ".join(f"Look out: {link.warning}." for link in links if link.warning)
    return Section("Links", text, tables=[_link_table(link) for link in links])


def _link_table(link: "LinkChange") -> Table:
    rows = []
    for q in link.quantities:
        kind, _, axis = q.name.partition("_")
        name = f"{NAMES[kind]} {axis}".strip()
        # Rounding leaves a tiny number where the exact value is zero.
        value = q.value if abs(q.value) > 1e-6 * max(q.std, abs(q.described)) else 0.0
        certain = "yes" if q.determined else "not by these runs"
        rows.append([name, f"{q.described:.4g}", f"{value:.4g}", f"{q.std:.2g}", q.unit, certain])
    caption = (
        f"The link that {link.joint} moves, with all that is fixed to it, in the frame of that joint; inertia is about "
        "the centre of mass."
    )
    return Table([link.joint, "URDF", "repaired", "std", "unit", "determined"], rows, caption)


def misfit_figure(study: Study, found: Repair) -> list[KeyFigure]:
    """The share that the sentence tells; nothing where nothing was added."""
    if len(found.path) < 2:
        return []
    whose = WHOSE[study.judges[0]].rstrip(",")
    return [KeyFigure("Misfit explained", in_percent(found.explained), f"by what was added; {whose}")]


LEVELS = {
    Verdict.EXPLAINED: Level.GOOD,
    Verdict.EFFECT_MISSING: Level.CAUTION,
    Verdict.CANNOT_TELL_APART: Level.CAUTION,
    Verdict.UNKNOWN_EFFECT: Level.CAUTION,
}


def diagnosis_report(study: Study, found: Diagnosis, command: str = "") -> Report:
    """What every effect would change, and the curves with the best ones."""
    steps = found.search.steps
    path = [repair_step(study, step) for step in steps]
    names = [step_name(step) for step in path]
    shown = Overlays.of_study(study, [step.fit for step in steps], names, found.comparison.places)
    given = {name: channel.rmse for name, channel in found.comparison.channels.items()}
    evidence = evidence_section(found.suspects, found.remedies, given, found.comparison.scale, summaries(study))
    return Report(
        title="Diagnose: which effect is missing",
        level=LEVELS[found.verdict],
        verdict=found.sentence,
        sections=[
            *missing_force_sections(found.missing_force, _added(path)),
            evidence,
            shown.section(),
            *fit_sections(found.comparison, shown, "the model as given"),
        ],
        subtitle=runs_of(study),
        key_figures=key_figures(shown),
        command=command,
    )


def _added(path: Sequence[RepairStep]) -> str:
    """What came in after the model as given, for a legend."""
    effects = added_effects(path)
    return " + ".join(effects) if len(effects) <= MOST_EFFECTS else f"with {len(effects)} effects"


def summaries(study: Study) -> dict[str, str]:
    """What every effect is, by its name."""
    return {name: effect.summary for name, effect in study.effects.items()}


MUCH = 0.5
"""Share of the misfit; a repair that explains more is an improvement, whatever it leaves."""


def repair_level(found: Repair) -> Level:
    """Done where only noise is left, improved where much is explained, failed only where the error grew."""
    if found.verdict is Verdict.EXPLAINED and found.after.widened == 1.0:
        return Level.GOOD
    if found.explained < 0.0:
        return Level.BAD
    return Level.IMPROVED if found.explained > MUCH else Level.CAUTION


def repair_report(study: Study, found: Repair, command: str = "", next_steps: Sequence[NextStep] = ()) -> Report:
    """Before and after, the error falling, what became of an arm's links, then the repaired fit."""
    links = [link_section(found.links)] if found.links else []
    names = [step_name(step) for step in found.path]
    shown = Overlays.of_study(study, [step.fit for step in found.steps], names, found.after.places)
    path = RepairPath(found.path, found.after.scale, study.judges, summaries(study)).section()
    return Report(
        title="Repair: add what is missing, watch the error fall",
        level=repair_level(found),
        verdict=found.sentence,
        sections=[
            *missing_force_sections(found.missing_force, _added(found.path)),
            shown.section(),
            path,
            *links,
            *fit_sections(found.after, shown, "the last step"),
        ],
        subtitle=runs_of(study),
        key_figures=[*misfit_figure(study, found), *key_figures(shown)],
        command=command,
        next_steps=next_steps,
    )
