"""The result of a discovery: formulas with values and evidence, their file of effects, and their tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armdyn import atomic
from armdyn.discovery.source import effects_file_text, indented_lines
from armdyn.discovery.term import CandidateTerm
from armdyn.displayable import Displayable
from armdyn.document import Document, ResultLevel, Section, Table
from armdyn.effects.catalogue import STAGES
from armdyn.effects.user import load_effects
from armdyn.errors import InputError
from armdyn.identify.explained_share import percent_text
from armdyn.identify.residual.missing_force import ForceCurve, pool_curves
from armdyn.identify.tables import missing_force_columns
from armdyn.parameter import Parameter
from armdyn.physics.definition import RATE_STAGE

MIN_ERROR_SHARE_EXPLAINED_BY_LAWS = 0.5
"""Least share of the squared error that the discovered laws must explain for a good result."""


@dataclass(frozen=True, eq=False)
class DiscoveredLaw:
    """One discovered law: a formula for a missing force with its values, or an effect of the catalogue.

    Attributes:
        effect: name of the effect.
        joints: joints on which it acts, for an arm; empty for other bases.
        acts_on: the stage (part of the equations) on which it acts.
        kind: the kind of law in a word or two; the effect's name where it is an effect of the catalogue.
        description: what the law does, in words.
        formula: the formula, for a reader.
        values: its parameters by short name.
        explained_share: share of the squared error that it explains in addition to the laws found before it.
        known_as: name of the catalogue's effect that it is, or that explains as much; None where there is none.
        rivals: formulas of another kind that these runs cannot distinguish from it.
        term: the term that can be written to a file of effects; None for an effect of the catalogue.
    """

    effect: str
    joints: tuple[str, ...]
    acts_on: str
    kind: str
    description: str
    formula: str
    values: Mapping[str, Parameter]
    explained_share: float
    known_as: str | None
    rivals: tuple[str, ...]
    term: CandidateTerm | None

    @property
    def joint(self) -> str | None:
        """Names of the joints on which the law acts, joined by commas; None for a base without joints."""
        return ",".join(self.joints) or None

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Quantities on which the law depends (``"speed"``, ``"extra.temperature"``); empty for a catalogue effect."""
        return () if self.term is None else tuple(v.quantity for v in self.term.variables)

    @property
    def label(self) -> str:
        """The effect in the form that `armdyn add` takes."""
        return f"{self.effect}:{self.joint}" if self.joint else self.effect

    @property
    def value_texts(self) -> dict[str, str]:
        """Texts for a reader, such as ``"stiffness = 3.2 ± 0.1 N m/rad"``, by the short name of the parameter."""
        return {name: f"{name} = {_number(value)}" for name, value in self.values.items()}

    @property
    def sentence(self) -> str:
        """The formula with its values, as a sentence."""
        values = ", ".join(text for name, text in self.value_texts.items() if not name.startswith("value_"))
        at = f"{self.joint}: " if self.joint else ""
        return f"{at}{self.formula}" + (f" with {values}" if values else "")


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Displayable):
    """Result of a discovery.

    Attributes:
        laws: discovered laws, the one that explains most first; empty where none was found.
        rmse_before: root mean square error of the model as given on the fitted runs, by channel.
        rmse_after: root mean square error of the model with all findings on the fitted runs, by channel.
        held_out_rmse_before: root mean square error of the model as given, by channel, on held-out runs or on runs
            predicted from the others; empty for a single run.
        held_out_rmse: root mean square error of the model with all findings, on the runs of `held_out_before`.
        noise: standard deviation of the noise by channel.
        units: unit by channel.
        explained_share: share of the squared error that all findings explain.
        residual_exceeds_noise: whether the residual is more than noise.
        has_unfitted_run: whether the error was measured on at least one run that was not fitted.
        runs: names of the fitted runs.
        held_out: names of the held-out runs.
        nothing_moves: whether all predicted channels of the fitted runs are constant within the noise.
        missing_force: curves of the missing force before and after.
    """

    laws: tuple[DiscoveredLaw, ...]
    rmse_before: Mapping[str, float]
    rmse_after: Mapping[str, float]
    held_out_rmse_before: Mapping[str, float]
    held_out_rmse: Mapping[str, float]
    noise: Mapping[str, float]
    units: Mapping[str, str]
    explained_share: float
    residual_exceeds_noise: bool
    has_unfitted_run: bool
    runs: tuple[str, ...]
    held_out: tuple[str, ...]
    nothing_moves: bool = False
    missing_force: tuple[ForceCurve, ...] = ()

    @property
    def laws_outside_catalogue(self) -> tuple[DiscoveredLaw, ...]:
        """The discovered laws that are not effects of the catalogue."""
        return tuple(one for one in self.laws if one.term is not None)

    @property
    def sentence(self) -> str:
        """The result in one or two sentences, for a reader."""
        if not self.laws:
            return self._why_nothing()
        text = f"Found {'; '.join(one.sentence for one in self.laws)}. "
        text += f"It explains {percent_text(self.explained_share)} of the misfit"
        text += (
            "."
            if self.has_unfitted_run
            else ", in the one recording that it was fitted to: hold another one out to believe it."
        )
        in_catalogue = [one for one in self.laws_outside_catalogue if one.known_as]
        known = [f"{one.formula.split(' = ')[0]} is {one.known_as} of the catalogue as well" for one in in_catalogue]
        rivals = dict.fromkeys(r for one in self.laws for r in one.rivals)
        text += f" {'; '.join(known)}." if known else ""
        text += f" These runs cannot distinguish it from {'; '.join(rivals)}." if rivals else ""
        return text + (
            " More than noise is left." if self.residual_exceeds_noise and self.explained_share < 0.99 else ""
        )

    def _why_nothing(self) -> str:
        if not self.residual_exceeds_noise:
            still = " But nothing moves by more than the noise: record a motion, which shows a law."
            return f"Nothing is missing: what is left is noise.{still if self.nothing_moves else ''}"
        other = ", and another motion: one alone shows a force in few places and at few speeds"
        return (
            "Something is missing, and no formula and no curve over what this model knows explains it: it may be the "
            "force of another body, or depend on what was not recorded. Record what it may depend on as well, as a "
            f"column such as 'extra.temperature [degC]'{'' if self.has_unfitted_run else other}."
        )

    def file_text(self) -> str:
        """Text of a Python file that defines the discovered laws as effects, with their evidence in docstrings.

        Raises:
            InputError: no law was discovered that the catalogue lacks.
        """
        if not self.laws_outside_catalogue:
            raise InputError("nothing was discovered that the catalogue lacks, so there is no effect to write")
        evidence = {one.effect: self._evidence(one) for one in self.laws_outside_catalogue}
        return effects_file_text(
            "Discovered by armdyn: what the model lacked, as effects.",
            [o.term for o in self.laws_outside_catalogue if o.term],
            evidence,
        )

    def write(self, path: Path | str) -> None:
        """Write the discovered laws to a Python file of effects, and check that the file can be loaded.

        Raises:
            InputError: no law was discovered that the catalogue lacks, or the file cannot be written.
        """
        path = Path(path)
        atomic.write_text(path, self.file_text())
        load_effects(path, (*STAGES, RATE_STAGE))

    def _evidence(self, one: DiscoveredLaw) -> str:
        """The evidence in a docstring: the values, the share that they explain, the data of the picture."""

        def errors(before: Mapping[str, float], after: Mapping[str, float]) -> str:
            return ", ".join(f"{c} {before[c]:.3g} to {error:.3g} {self.units[c]}" for c, error in after.items())

        text = f"Fitted to {', '.join(self.runs)}" + (
            f", chosen with {', '.join(self.held_out)}" if self.held_out else ""
        )
        text += f": it explains {percent_text(one.explained_share)} of the misfit; rms error "
        text += errors(self.rmse_before, self.rmse_after)
        if self.held_out_rmse:
            text += f"; of runs not fitted {errors(self.held_out_rmse_before, self.held_out_rmse)}"
        if one.rivals:
            text += f". These runs cannot distinguish it from {'; '.join(one.rivals)}"
        parts = [f"{text}.", "\n".join(one.value_texts.values())]
        drawn = _curve_of(one, self.missing_force)
        if drawn is not None:
            points = ", ".join(f"{x:.3g}: {y:.3g}" for x, y in zip(drawn.x, drawn.as_given, strict=True))
            parts.append(f"The missing force, {drawn.unit}, over the {drawn.against}, {drawn.x_unit}:\n{points}")
        return "\n\n".join(map(indented_lines, parts))

    def document(self) -> Document:
        """Build the tables: the laws with their values, then the errors."""
        laws = [
            [o.formula, o.label, ", ".join(o.value_texts.values()), percent_text(o.explained_share), o.known_as or "",
             "; ".join(o.rivals)]
            for o in self.laws
        ]  # fmt: skip
        nothing = dict.fromkeys(self.rmse_after, float("nan"))
        kinds = (nothing | dict(errors) for errors in (self.held_out_rmse_before, self.held_out_rmse))
        columns = (self.units, self.noise, self.rmse_before, self.rmse_after, *kinds)
        errors = [[channel, *(column[channel] for column in columns)] for channel in self.rmse_after]
        found = Table.of(["formula", "effect", "values", "explains", "known as", "as good"], laws)
        heads = ["channel", "unit", "noise", "as given", "with it", "not fitted, as given", "not fitted, with it"]
        sections = [Section("What was found", tables=[found])] if laws else []
        sections.append(Section("Errors", "Root mean square.", tables=[Table.of(heads, errors)]))
        level = (
            ResultLevel.CAUTION
            if self.residual_exceeds_noise and self.explained_share < MIN_ERROR_SHARE_EXPLAINED_BY_LAWS
            else ResultLevel.GOOD
        )
        data = {"missing_force": lambda: missing_force_columns(self.missing_force)}
        return Document("Discover", self.sentence, sections, level, data=data)


def _curve_of(one: DiscoveredLaw, curves: Sequence[ForceCurve]) -> ForceCurve | None:
    """The curve of the missing force over the quantity on which a law depends."""
    mine = [c for c in pool_curves(curves) if c.joint == one.joint]
    return next((c for name in one.depends_on for c in mine if c.against == name), None)


def _number(value: Parameter) -> str:
    text = f"{value.value:.4g}"
    if value.std is not None and np.isfinite(value.std) and value.std > 0.0:
        text += f" ± {value.std:.2g}"
    return f"{text} {value.unit}".removesuffix(" 1")
