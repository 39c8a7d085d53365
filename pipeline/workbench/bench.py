"""State of the workbench: a model that is compared with recordings, while the user adds and removes effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armdyn.arm.closed_loop.rollout import SimulatedPositionError, simulated_position_errors
from armdyn.arm.model import ArmModel
from armdyn.effects.effect import Effect
from armdyn.errors import UnknownNameError
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.fit import Fit, channel_rmse, continue_fit
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.residual.failing_ranges import FailingRange, find_failing_ranges
from armdyn.identify.residual.missing_force import (
    ForceCurve,
    MissingForce,
    force_added_by_repair,
    force_curves,
    missing_forces,
)
from armdyn.identify.residual.noise_tests import linearised_fit
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.study import Study
from armdyn.parameter import Parameter
from armdyn.recording.channels import FloatArray
from pipeline.report.overlay import FITTED_RUN, HELD_OUT_RUN, SignalOverlay, study_overlays

AS_GIVEN_CURVE_LABEL, TICKED_EFFECTS_CURVE_LABEL = "as given", "now"
ResidualsByChannel = Mapping[tuple[str, str], FloatArray]
"""Measured minus predicted values (n,), in the channel's unit, by run and channel."""


@dataclass(frozen=True)
class ParameterSlider:
    """Slider with which the user sets a parameter of the model.

    Attributes:
        parameter: parameter with unit, bounds, present value, and standard deviation if it is known.
        low: lowest value of the slider, in the parameter's unit.
        high: highest value of the slider, in the parameter's unit.
    """

    parameter: Parameter
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SelectedEffectsModel:
    """The model with the effects that the user has ticked, and its curves and errors.

    Attributes:
        effects: labels of the ticked effects, in the order of ticking.
        how: source of the parameters: "predicted" (linearised), "fitted", or "by hand" (from sliders).
        curves: signals of every training and held-out run, with residuals of the given and of this model.
        stale: whether the curves of held-out runs still show the given model.
        knobs: sliders of the parameters, by parameter.
        others: error by channel on runs outside the fit; empty while it is unknown.
        places: intervals in which the model fails, the worst first; empty while unknown, or if only noise remains.
    """

    effects: tuple[str, ...]
    how: str
    curves: tuple[SignalOverlay, ...]
    stale: bool
    knobs: Mapping[str, ParameterSlider]
    others: Mapping[str, float]
    places: tuple[FailingRange, ...] = ()


class Workbench:
    """A model, recordings and a catalogue of effects, with the results of adding effects.

    Args:
        study: model, recordings and catalogue.

    Attributes:
        study: model, recordings and catalogue.
        first: fit of the given model.
        candidates: effects that the user can tick, by label, separately for each joint.
        present: effects of the given model, by label, separately for each joint.
    """

    def __init__(self, study: Study) -> None:
        self.study, self.first = study, study.first()
        self.candidates, self.present = (
            {one.label: one for c in known for one in c.split_by_joint()} for known in (study.candidates, study.present)
        )
        self._fits: dict[frozenset[str], Fit] = {frozenset(): self.first}
        self._places = find_failing_ranges(self.first)
        self._given = [
            replace(curve, residuals=np.repeat(curve.residuals, 2, axis=0))
            for curve in study_overlays(study, [self.first], self._places)
            if curve.kind in (FITTED_RUN, HELD_OUT_RUN)
        ]

    @cached_property
    def linear_scorer(self) -> LinearScorer | None:
        """Linearisation of an arm's fit, which predicts the result of any set of effects at once; None for a pendulum.

        Predictions are exact for effects that are linear in their parameters.
        """
        return self.study.scorer(self.first)

    @cached_property
    def given_state(self) -> SelectedEffectsModel:
        """Curves and errors of the given model, without ticked effects."""
        state = self._state((), "fitted", {}, self._knobs(self.first), self._others(self.first))
        return replace(state, stale=False, places=self._places)

    def effects_of(self, effects: Sequence[str]) -> list[Effect]:
        """Effects of some labels, with all joints of one effect together, as `repair.add` expects them.

        Raises:
            UnknownNameError: a label is not one of `candidates`.
        """
        return [self.study.effects[c.effect].on(*c.joints) for c in group_by_effect(self._candidates_of(effects))]

    def predict(self, effects: Sequence[str]) -> SelectedEffectsModel:
        """Predict the result of adding effects from a linearisation, without a fit.

        Args:
            effects: labels of the effects.

        Raises:
            UnknownNameError: a label is not one of `candidates`.
        """
        if not effects:
            return self.given_state
        chosen = self._candidates_of(effects)
        if self.linear_scorer is None:
            # Near the fit of the given model a pendulum is nearly linear too; a refit follows.
            values = linearised_fit(self.first, [name for c in chosen for name in c.names])
            blocks, moved = self.study.problem.blocks(self.first.values), values - self.first.values
            residuals = {(b.run, b.channel): b.misfit - b.noise * (b.sensitivities @ moved) for b in blocks}
        else:
            around, sums = self.linear_scorer, self.linear_scorer.sums
            one = around.evaluate((*around.given, *chosen))
            values = self.study.values_predicted_by_scorer(around, one)
            residuals = {
                (sums.runs[sums.run[unit]], sums.channels[sums.channel[unit]]): sums.residual(
                    unit, one.columns, one.change
                )
                for unit in range(len(sums.equations.count))
            }
        absent = {name for c in self.study.candidates for name in c.names} - {name for c in chosen for name in c.names}
        known = {column.name: None for column in self.study.problem.columns if column.name not in absent}
        return self._state(effects, "predicted", residuals, self._knobs_at(values, known))

    def refit(self, effects: Sequence[str]) -> SelectedEffectsModel:
        """The result of adding effects, fitted to all samples in 0.1 s to several seconds.

        Args:
            effects: labels of the effects.

        Raises:
            UnknownNameError: a label is not one of `candidates`.
        """
        fit = self.fit(effects)
        held_out = self.study.held_out_blocks(fit) if self.study.held_out else []
        residuals = _residuals([*fit.blocks, *held_out])
        state = self._state(effects, "fitted", residuals, self._knobs(fit), self._others(fit))
        return replace(state, places=find_failing_ranges(fit))

    def fit(self, effects: Sequence[str]) -> Fit:
        """Fit of the model with added effects, by their labels; earlier fits are kept."""
        key = frozenset(effects)
        if key not in self._fits:
            study, chosen = self.study, self._candidates_of(effects)
            whole = (*study.present, *group_by_effect(chosen))
            near = self._fits[min(self._fits, key=lambda other: (len(other ^ key), self._fits[other].cost))]
            around = self.linear_scorer
            start = (
                None
                if around is None
                else study.values_predicted_by_scorer(around, around.evaluate((*around.given, *chosen)))
            )
            self._fits[key] = continue_fit(study.fit_base_with_effects(whole, near, start))
        return self._fits[key]

    def with_values(self, effects: Sequence[str], values: Mapping[str, float]) -> SelectedEffectsModel:
        """Prediction of the fitted model with some parameters at other values.

        Args:
            effects: labels of the added effects.
            values: value of each changed parameter in its unit, by name.

        Raises:
            UnknownNameError: the model has no parameter of this name.
        """
        fit = self.fit(effects)
        lean, knobs, at = self.study.without_unused_effects(fit), dict(self._knobs(fit)), {}
        for name, value in values.items():
            if name not in knobs:
                raise UnknownNameError("parameter", name, list(knobs))
            parameter = knobs[name].parameter
            at[name] = float(np.clip(value, parameter.lower, parameter.upper))
            knobs[name] = replace(knobs[name], parameter=parameter.with_value(at[name]))
        runs = [*lean.problem.runs, *(self.study.held_out if self.study.sums_predict else ())]
        problem = Problem(lean.problem.model, runs, lean.problem.noise)
        start = {lean.problem.unknown_name_and_run(i): value for i, value in enumerate(lean.values)}
        theta = np.array(
            [at.get(c.name, start[problem.unknown_name_and_run(i)]) for i, c in enumerate(problem.columns)]
        )
        blocks = problem.blocks(theta, np.zeros(len(theta), dtype=bool))
        return self._state(effects, "by hand", _residuals(blocks), knobs)

    def missing_force(self, state: SelectedEffectsModel) -> tuple[ForceCurve, ...]:
        """Missing force of the given model and, if known, of the model with ticked effects."""
        given = self._unexplained
        if not state.effects or any(u.joint is None for u in given):
            if not state.effects or state.how != "fitted":
                return force_curves(given)
            fit = self.fit(state.effects)
            return force_curves(given, missing_forces(fit), force_added_by_repair(self.first, fit))
        now = {(curve.run, curve.channel): curve.residuals[-1] for curve in state.curves if curve.kind == FITTED_RUN}
        left = [now[u.run, f"tau.{u.joint}"] for u in given]
        return force_curves(
            given,
            [replace(u, value=of) for u, of in zip(given, left, strict=True)],
            [replace(u, value=u.value - of) for u, of in zip(given, left, strict=True)],
        )

    def motion(self, effects: Sequence[str]) -> tuple[SimulatedPositionError, ...]:
        """Simulated motion of an arm with added effects under recorded commands or torques; empty for a pendulum."""
        fit, study = self.fit(effects), self.study
        model = study.model_with((*study.present, *group_by_effect(self._candidates_of(effects))))
        values = {name: p.value for name, p in fitted_parameters(study, fit).items() if name in model.names}
        arm = model.with_values(values).capability(ArmModel)
        return () if arm is None else simulated_position_errors(arm, study.recordings)

    @cached_property
    def _unexplained(self) -> list[MissingForce]:
        return missing_forces(self.first)

    def _candidates_of(self, effects: Sequence[str]) -> list[Candidate]:
        for label in effects:
            if label not in self.candidates:
                raise UnknownNameError("effect to tick", label, list(self.candidates))
        return [self.candidates[label] for label in effects]

    def _state(
        self,
        effects: Sequence[str],
        how: str,
        residuals: ResidualsByChannel,
        knobs: Mapping[str, ParameterSlider],
        others: Mapping[str, float] | None = None,
    ) -> SelectedEffectsModel:
        shown, stale = [], False
        for curve in self._given:
            left = residuals.get((curve.run, curve.channel))
            stale |= left is None
            shown.append(curve if left is None else replace(curve, residuals=np.stack([curve.residuals[0], left])))
        return SelectedEffectsModel(tuple(effects), how, tuple(shown), stale, knobs, others or {})

    def _others(self, fit: Fit) -> Mapping[str, float]:
        """Error by channel on held-out runs, or else of every run predicted from the others."""
        return channel_rmse(self.study.held_out_blocks(fit))

    def _knobs(self, fit: Fit) -> Mapping[str, ParameterSlider]:
        described = fitted_parameters(self.study, fit)
        return self._knobs_at(fit.values, {name: p.std for name, p in described.items()})

    def _knobs_at(self, values: FloatArray, stds: Mapping[str, float | None]) -> Mapping[str, ParameterSlider]:
        """Sliders of the model's parameters that `stds` names, at `values` (P,) of the study's unknowns."""
        found = {}
        for column, value in zip(self.study.problem.columns, values.tolist(), strict=True):
            if column.run is None and column.name in stds:
                parameter = replace(column.parameter, value=value, std=stds[column.name])
                reach = max(5.0 * (parameter.std or 0.0), 0.5 * abs(value), 0.5 * parameter.typical)
                ends = max(value - reach, parameter.lower), min(value + reach, parameter.upper)
                found[column.name] = ParameterSlider(parameter, *ends)
        return found


def _residuals(blocks: Sequence[ResidualBlock]) -> dict[tuple[str, str], FloatArray]:
    return {(block.run, block.channel): block.misfit for block in blocks}
