"""The model of a user's physics: it predicts the sensor readings of a run, with any set of effects."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from armdyn.effects.catalogue import catalogue_order
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.model import Prediction
from armdyn.object_cache import cached_with_first_argument
from armdyn.parameter import Parameter
from armdyn.physics.definition import DEFAULT_STEP_PERIODS, Physics
from armdyn.physics.following import Following, with_exact_steps
from armdyn.physics.formulation import Formulation, formulate
from armdyn.physics.recorded import InputPath, is_piecewise_constant, recorded_inputs
from armdyn.physics.restarts import predict_in_pieces, restart_seconds
from armdyn.physics.simulated import (
    LOCAL_FIT_HALF_WIDTH_PERIODS,
    START_PARABOLA_SECONDS,
    SimulatedModel,
    first_value_and_rate,
    local_values_and_rates,
)
from armdyn.physics.stiff import is_stiff, stable_step, stable_step_divisions
from armdyn.physics.without_effects import (
    adds_states,
    bare_formulation,
    joints_changed_by,
    shown_states,
    start_grid,
)
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES
from armdyn.recording.noise import NoiseByChannel
from armdyn.recording.spikes import MAX_UNAVERAGED_RATE_HZ, without_faulty_samples
from armdyn.recording.units import to_base_units
from armdyn.run import Channel, Run

PARAMETER_CHANGE_TYPICAL_SIZES = 0.01
"""Change of parameters along a direction, in their typical sizes, that shows which states depend on it."""


@dataclass(frozen=True, repr=False)
class PhysicsModel(SimulatedModel):
    """Model of a user's own physics, with effects.

    Attributes:
        physics: the physics.
        own_effects: effects that come with the physics.
        file: file from which the physics was read; None for a physics without a file.
    """

    physics: Physics
    own_effects: tuple[Effect, ...] = ()
    file: Path | None = None

    def suited_to(self, runs: Sequence[Run], noise: NoiseByChannel) -> Self:
        """See `SimulatedModel`; in pieces, if errors of the start grow from the noise to the motion's size."""
        begun = [self.with_values(self.guess_start_state(run)).theta() for run in runs]
        following = replace(self.following, restart=restart_seconds(self, runs, noise))
        return replace(self, following=following).refined_for(runs, noise, begun)

    def refined_for(self, runs: Sequence[Run], noise: NoiseByChannel, thetas: Sequence[np.ndarray]) -> Self:
        """See `SimulatedModel`; steps are halved until chi2 of the runs stays."""

        def predicted(following: Following, run: Run, theta: np.ndarray) -> Mapping[str, np.ndarray]:
            return replace(self, following=following).predict_values(run, theta)

        return replace(self, following=with_exact_steps(self.following, predicted, runs, thetas, noise))

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """See `SimulatedModel.predict`; in pieces, where the following starts anew."""
        length = self.following.restart
        return super().predict(run, theta) if length is None else predict_in_pieces(self, run, theta, length)

    @property
    def base(self) -> str:
        """Name of the physics, which is the base of its model."""
        return self.physics.name

    def file_entries(self, folder: Path) -> Mapping[str, Any]:
        """Entries of a model file for this base: the path of the user's file, relative to `folder`.

        Raises:
            InputError: the physics was not read from a file.
        """
        if self.file is None:
            raise InputError(f"the physics '{self.base}' comes from no file: read it with load_base to keep its model")
        return {"base": Path(os.path.relpath(self.file, folder.resolve())).as_posix()}

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages on which effects may act, in the order in which the equations use them."""
        return tuple(bare_formulation(self.physics).stages)

    @property
    def has_catalogue_stages(self) -> bool:
        """Whether effects of the catalogue can act on the stages of this model: never, even if stages share a name."""
        return False

    @property
    def step(self) -> float:
        """Longest step of the integration, s."""
        return self.physics.step

    @property
    def min_seconds_to_identify_effect(self) -> float:
        """Length of a run, s, below which friction and creep are not identifiable: three periods of the motion."""
        return 3.0 * self.physics.period

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that drive the motion."""
        return tuple(self.physics.inputs)

    @property
    def start_names(self) -> tuple[str, ...]:
        """Names of the parameters that are the state at the start of a motion."""
        return tuple(p.name for p in self.physics.states.values())

    @property
    def formulation(self) -> str:
        """Identifier of the equations: the name of the physics."""
        return self.base

    @cached_property
    def system(self) -> Formulation:
        """The equations of the physics with the effects of the model."""
        starts = set(self.start_names)
        names, stiff = tuple(n for n in self.names if n not in starts), is_stiff(self.physics, self.effects)
        return formulate(self.physics, catalogue_order(self.effects), names, stiff=stiff)

    def guess_start_state(self, run: Run) -> Mapping[str, float]:
        """First guesses of the state at the start of a run, from measured states and their measured rates."""
        states = self.physics.states
        guess = shown_states(
            self.physics,
            run,
            lambda channel: first_value_and_rate(channel, START_PARABOLA_SECONDS * self.physics.period),
        )
        return {states[n].name: float(np.clip(v, states[n].lower, states[n].upper)) for n, v in guess.items()}

    def possible_start_states(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start states from which a fit is tried: a grid over the unmeasured states."""
        del theta
        guess = self.guess_start_state(run)
        unknown = [p for p in self.physics.states.values() if p.name not in guess]
        return [{**guess, **start} for start in start_grid(unknown)]

    def start_state_window_seconds(self, theta: np.ndarray) -> float:
        """Length of a run, s, that determines the state at its start: one period."""
        del theta
        return self.physics.period

    def joints_effect_can_act_on(self, effect: Effect) -> tuple[str, ...]:
        """Joints on which an effect changes the equations.

        Raises:
            UnknownNameError: the effect names a joint that the stage lacks.
            InputError: the effect changes nothing on a joint that it names.
        """
        found = joints_changed_by(self.physics, effect)
        joints = bare_formulation(self.physics).stages[effect.acts_on]
        for joint in effect.joints:
            if joints != ("",) and joint not in joints:
                raise UnknownNameError(f"joint of the {effect.acts_on}", joint, joints)
        return found

    def with_effect(self, effect: Effect) -> "PhysicsModel":
        """The model with one more effect, at its null values.

        Raises:
            InputError: the effect changes nothing in this physics.
        """
        if effect.acts_on in self.stages and not self.joints_effect_can_act_on(effect):
            raise InputError(f"the effect '{effect.name}' changes nothing in a model of base '{self.base}'")
        return super().with_effect(effect)

    @property
    def effects_with_states(self) -> frozenset[str]:
        """Names of the effects that add states."""
        return frozenset(effect.name for effect in self.effects if adds_states(self.physics, effect))

    def with_model_channels(self, run: Run) -> Run:
        """The run with its further quantities in the units of the equations, as channels."""
        declared = {**self.physics.inputs, **self.physics.outputs}
        found, noise = dict[str, Channel](), dict(run.noise)
        for name, channel in run.extra.items():
            if name in declared:
                (given, times, plus), (wanted, factor, zero) = map(to_base_units, (channel.unit, declared[name]))
                if given != wanted:
                    raise InputError(
                        f"{run.source or run.name}: '{name}' is in {channel.unit}, not in {declared[name]}: correct "
                        "the unit of one"
                    )
                value = (channel.value * times + (plus - zero)) / factor
                found[name] = Channel(channel.time, value, declared[name])
                if name in noise:
                    noise[name] *= times / factor
        return (
            replace(run, channels={**run.channels, **found}, base_channels=run.base_channels | set(found), noise=noise)
            if found
            else run
        )

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that the model predicts, in the order of the prediction."""
        channels = super().predicted_channels(run)
        for name, unit in (*self.physics.inputs.items(), *((n, self.physics.outputs[n]) for n in channels)):
            if name not in run.channels:
                raise InputError(f"{run.source or run.name}: holds no '{name}', which drives the motion: record it")
            if run.channels[name].unit != unit:
                raise InputError(f"{run.source or run.name}: '{name}' is in {run.channels[name].unit}, not in {unit}")
        return channels

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run without faulty samples, cut to the time in which all inputs were recorded."""
        del beside
        run = self.with_model_channels(run)
        names = self.predicted_channels(run)
        driving = [run.channels[name].time for name in self.physics.inputs]
        if driving:
            start, end = max(t[0] for t in driving), min(t[-1] for t in driving)
            cut = {n: c.selected((c.time >= start) & (c.time <= end)) for n, c in ((n, run.channels[n]) for n in names)}
            if min(len(channel) for channel in cut.values()) < MIN_COMPARED_CHANNEL_SAMPLES:
                driven = f"{' and '.join(self.physics.inputs)} were not recorded together with {', '.join(names)}"
                raise InputError(f"{run.source or run.name}: {driven}: record them together")
            run = replace(run, channels={**run.channels, **cut})
        return without_faulty_samples(
            run,
            names,
            self.physics.inputs,
            self._held(run),
            MAX_UNAVERAGED_RATE_HZ * DEFAULT_STEP_PERIODS / self.physics.step,
        )

    def jump_times(self, run: Run) -> np.ndarray:
        """(j,) times, s, at which an input that is held between its samples changes."""
        held = [run.channels[name] for name in self._held(run)]
        return np.sort(np.concatenate([np.zeros(0), *(c.time[1:][np.diff(c.value) != 0.0] for c in held)]))

    def _held(self, run: Run) -> list[str]:
        """Names of the inputs that keep their value until the next sample."""
        return [n for n in self.physics.inputs if n in self.physics.held or is_piecewise_constant(run.channels[n])]

    @property
    def speed_states(self) -> Mapping[int, str | None]:
        """Indices and names of the states whose time derivative is not a state, so that a force changes them."""
        names, rates = dict(enumerate(self.physics.states)), bare_formulation(self.physics).rates
        return {k: name for k, name in names.items() if name not in rates} or names

    def rates(self, run: Run, theta: np.ndarray) -> dict[str, np.ndarray]:
        """(K,) time derivatives along the simulated motion of a run, of the states that a force changes, by name."""
        path, physics = self.input_path(run), theta[self.parameter_positions[1]]
        states = self.states_along(run, theta)
        found = self.system.derivative.map(len(states))(states.T, self.simulation_inputs(path, physics).nodes, physics)
        own = dict(zip(self.physics.states, np.asarray(found), strict=False))
        return {
            name: row[np.isfinite(row)] for name, row in own.items() if name not in bare_formulation(self.physics).rates
        }

    @property
    def guessed_parameters(self) -> tuple[str, ...]:
        """Parameters whose values are only guesses: all those of the physics, and the start values."""
        return (*(p.name for p in self.physics.parameters), *self.start_names)

    def oscillation_period(self, run: Run, theta: np.ndarray) -> float:
        """Period of the motion that the physics declares, s."""
        del run, theta
        return self.physics.period

    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """(J, n) measured states at (J,) times, s; None where neither a state nor its integral has a channel."""
        del theta
        found = shown_states(
            self.physics,
            run,
            lambda channel: local_values_and_rates(channel, times, LOCAL_FIT_HALF_WIDTH_PERIODS * swing).T,
        )
        if not all(name in found for name in self.physics.states):
            return None
        return np.array([found[name] for name in self.physics.states]).reshape(-1, len(times)).T

    def force_covariates(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """(J,) values and unit of the states on which a missing acceleration may depend, by name."""
        del run, time, theta
        states = list(self.physics.states.items())
        found = {name: (motion[:, k], p.unit) for k, (name, p) in enumerate(states)}
        name, speeds = states[speed][0], set(bare_formulation(self.physics).rates.values())
        return {"speed" if n == name in speeds else n: one for n, one in found.items() if n == name or n not in speeds}

    def states_sensitive_to(self, run: Run, theta: np.ndarray, direction: np.ndarray) -> tuple[str, ...]:
        """Unmeasured states, with units, whose range changes by a tenth of a change of parameters along `direction`."""
        channels, starts = self.predicted_channels(run), len(self.physics.states)
        if self.following.restart is not None:
            return ()
        shown = {
            name
            for name, channel in bare_formulation(self.physics).channel_by_measured_state.items()
            if channel in channels
        }
        here, there = (
            self.rollout(self.input_path(run), theta + step * direction, channels).states[:, :starts]
            for step in (0.0, PARAMETER_CHANGE_TYPICAL_SIZES)
        )
        moved = np.abs(there - here).max(axis=0) > 0.1 * PARAMETER_CHANGE_TYPICAL_SIZES * np.ptp(here, axis=0)
        named = zip(self.physics.states.items(), moved, strict=True)
        return tuple(f"{name} [{p.unit}]" for (name, p), moves in named if moves and name not in shown)

    def input_path(self, run: Run) -> InputPath:
        """The recorded inputs of a run on an even grid."""
        return _recorded(run, self.physics, stable_step(self.physics, self.effects))

    def simulation_inputs(self, path: InputPath, physics: np.ndarray) -> InputPath:
        """The inputs, divided into steps that are short enough for a stable integration at these parameters (p,)."""
        parts = self.following.refinement * stable_step_divisions(self.system, self.physics, physics, path.dt)
        return replace(super().simulation_inputs(path, physics), steps_per_interval=parts)

    def states_along(self, run: Run, theta: np.ndarray) -> np.ndarray:
        """(K, n) states along the recorded inputs of a run: simulated, or measured where a simulation diverges."""
        path = self.input_path(run)
        if self.following.restart is None:
            return self.rollout(path, theta, self.predicted_channels(run)).states
        motion = self.measured_motion(run, path.time, theta, self.oscillation_period(run, theta))
        assert motion is not None
        inputs, physics = (
            self.simulation_inputs(path, theta[self.parameter_positions[1]]),
            theta[self.parameter_positions[1]],
        )
        begin = self.system.initial.map(len(motion))
        return np.asarray(begin(*motion.T[:, None], inputs.nodes[: self.system.input_count], physics)).T

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which residuals may depend, as the equations declare them, by name."""
        path, formulation = self.input_path(run), self.system
        states = self.states_along(run, theta)
        many = formulation.against.map(len(path.time))
        physics = theta[self.parameter_positions[1]]
        values = np.asarray(many(states.T, self.simulation_inputs(path, physics).nodes, physics))
        units = formulation.against_units
        return {
            name: Channel(path.time, row, unit)
            for (name, unit), row in zip(units.items(), values, strict=True)
            if np.isfinite(row).all()
        }


def physics_model(
    physics: Physics, effects: Iterable[Effect] = (), own_effects: Sequence[Effect] = (), file: Path | None = None
) -> PhysicsModel:
    """Build a model from a physics, with effects at their null values.

    Args:
        physics: the physics.
        effects: effects of the model.
        own_effects: effects that come with the physics, besides the catalogue's.
        file: file from which the physics was read.

    Raises:
        InputError: the equations cannot be used.
    """
    bare_formulation(physics)
    parameters: Mapping[str, Parameter] = MappingProxyType(
        {p.name: p for p in (*physics.parameters, *physics.states.values())}
    )
    model = PhysicsModel((), parameters, physics, tuple(own_effects), file)
    for name in (e.name for e in own_effects if e.acts_on not in model.stages):
        raise InputError(f"effect '{name}' acts on none of the stages {', '.join(model.stages)} of '{physics.name}'")
    for item in effects:
        model = model.with_effect(item)
    return model


@cached_with_first_argument
def _recorded(run: Run, physics: Physics, step: float) -> InputPath:
    return recorded_inputs(run, physics.inputs, physics.held, physics.outputs, step)
