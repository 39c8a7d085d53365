"""A model: a base, effects and parameters. It is never changed in place."""

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from armdyn.document import Column, Columns, Document, Section, Table, columns_of
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.parameter import Parameter, Prior, Quantity
from armdyn.run import Channel, Run
from armdyn.shown import Displayable

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange
    from armdyn.arm.rollout import RollOut
    from urdf import Robot


@dataclass(frozen=True)
class Prediction:
    """Prediction of a model for one run, with all channels one after another.

    Attributes:
        channels: names of the channels in the order of the blocks.
        slices: slice of each channel's samples.
        time: (n,) times of the samples, s.
        values: (n,) predicted values, in the channels' units.
        sensitivities: (n, p) exact derivatives with respect to the parameters, in the order of `Model.names`.
    """

    channels: tuple[str, ...]
    slices: Mapping[str, slice]
    time: np.ndarray
    values: np.ndarray
    sensitivities: np.ndarray


def join_channels(parts: Sequence[tuple[str, np.ndarray, np.ndarray, np.ndarray]]) -> Prediction:
    """Join channels, each with its name, times (n,) s, values (n,) and sensitivities (n, p), to a prediction."""
    names, times, values, sensitivities = zip(*parts, strict=True)
    ends = np.cumsum([len(time) for time in times]).tolist()
    slices = {name: slice(end - len(time), end) for name, time, end in zip(names, times, ends, strict=True)}
    return Prediction(names, slices, *(np.concatenate(blocks) for blocks in (times, values, sensitivities)))


@dataclass(frozen=True)
class Background:
    """Small values of unnamed effects of a model: together they improve the prediction, but none of them is reported.

    Attributes:
        width: prior standard deviation about their null values, in typical sizes; 0 where only values with certain
            evidence were fitted.
        names: names of the parameters, which no fit changes.
    """

    width: float
    names: tuple[str, ...]

    @property
    def label(self) -> str:
        """A short name such as ``"background of 57 small values"``."""
        count = len(self.names)
        return f"background of {count} small value{'' if count == 1 else 's'}"

    @property
    def sentence(self) -> str:
        """The background in one sentence, for a reader."""
        return f"Not listed: a {self.label}, of a width of {self.width:.3g} typical sizes."


@dataclass(frozen=True, repr=False)
class Model(Displayable):
    """Base class of `PendulumModel` and `ArmModel`.

    Attributes:
        effects: effects in the order in which they were added.
        parameters: parameters by name, those of the base first, then those of the effects; `names` gives the order in
            vectors.
        background: small unnamed values among the effects' parameters; None where there are none. All parameters of an
            effect on one joint are in the background, or none.
    """

    effects: tuple[Effect, ...]
    parameters: Mapping[str, Parameter]
    background: Background | None = field(default=None, kw_only=True)

    linear = False
    """Whether predictions are linear in most unknowns; one expansion then predicts the influence of any set of
    effects."""

    @property
    def step(self) -> float:
        """Approximate step of a simulation, s; it limits the length of a recording that can be simulated."""
        return 0.005

    @property
    def settled_window(self) -> float:
        """Length of a part of a run, s, below which friction and creep are not identifiable."""
        return 3.0

    def __str__(self) -> str:
        """The base, its values and its effects, in one line."""
        said = [effect.label for effect in self.named_effects] or ["no effects"]
        said += [self.background.label] if self.background is not None else []
        return f"{self.about}; {', '.join(said)}"

    __repr__ = __str__

    @property
    def about(self) -> str:
        """The base with its values, without usual values that no fit changes and without effects."""
        shared = (p for p in self.parameters.values() if p.scope == "shared" and not p.effect)
        own = (p for p in shared if not p.considered or p.value != p.null)
        values = ", ".join(f"{p.name} {p.value:.4g} {p.unit}" for p in own)
        return f"{self.base}, {values}" if values else self.base

    def document(self) -> Document:
        """Build the table of parameters."""
        shared = {name: p for name, p in self.named_only().parameters.items() if p.scope == "shared"}
        values = shared.values()
        columns = [Column("parameter", list(shared)), *columns_of(values, value=".6g")]
        columns += [Column("std", [p.std for p in values], ".2g"), *columns_of(values, unit="", fitted="")]
        tables = [Table(columns, name="parameters")]
        said = self.background.sentence if self.background is not None else ""
        sections = [Section("Parameters", said, tables=tables)]
        return Document(f"Model: {self.base}", f"{self}.", sections, data=self.background_data())

    def background_data(self) -> Mapping[str, Callable[[], Columns]]:
        """The values of its background as a table of a document's data; empty where it has none."""
        return {} if self.background is None else {"background": self._background_columns}

    def _background_columns(self) -> Columns:
        """Table of the background: one row per value."""
        held = [self.parameters[name] for name in self.background.names] if self.background is not None else []
        columns = [Column("parameter", [p.name for p in held]), *columns_of(held, effect="", joint="", value="")]
        columns += [*columns_of(held, unit=""), Column("typical_sizes", [(p.value - p.null) / p.typical for p in held])]
        return Table(columns).values

    def guess_start(self, run: Run) -> Mapping[str, float]:
        """First guesses of the parameters with one value per run: the state at the start of a simulated motion."""
        del run
        return {}

    def possible_starts(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start states from each of which a fit is tried; empty where a fit converges from any start.

        Args:
            run: a recording.
            theta: (p,) parameter values.
        """
        del run, theta
        return ()

    def start_window(self, theta: np.ndarray) -> float:
        """Length of a run, s, that suffices to choose among the possible starts; `theta` is (p,)."""
        del theta
        return np.inf

    def between_gaps(self, run: Run) -> tuple[Run, ...]:
        """The parts of a run between missing samples; the whole run, where a simulation goes on through a gap."""
        return (run,)

    def pieces(self, run: Run) -> Sequence[Run]:
        """The run, or its parts with a start state each."""
        return (run,)

    def changes_link(self, names: Sequence[str]) -> bool:
        """Whether the parameters `names`, of one effect on one joint, change a link's mass, centre or inertia."""
        del names
        return False

    def link_changes(
        self, theta: np.ndarray, covariance: np.ndarray, of_runs_alone: np.ndarray, free: np.ndarray
    ) -> tuple["LinkChange", ...]:
        """Links that effects change, in the order of the joints; empty for a model without links.

        Args:
            theta: (p,) fitted parameters.
            covariance: (p, p) covariance of the parameters.
            of_runs_alone: (p, p) covariance nearly without priors.
            free: (p,) bool, fitted parameters.
        """
        del theta, covariance, of_runs_alone, free
        return ()

    @property
    @abstractmethod
    def base(self) -> str:
        """Name of the physics, without effects."""

    @property
    @abstractmethod
    def stages(self) -> tuple[str, ...]:
        """Names of the stages on which effects of this model may act."""

    def described(self, folder: Path) -> Mapping[str, Any]:
        """Entries of a model file that name the base; paths in them are relative to the file's `folder`."""
        del folder
        return {"base": self.base}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of every parameter vector."""
        return tuple(self.parameters)

    def value(self, name: str) -> float:
        """Value of a parameter, in its unit."""
        return self._parameter(name).value

    def theta(self) -> np.ndarray:
        """(p,) values in the order of `names`."""
        return np.array([p.value for p in self.parameters.values()])

    def with_effect(self, effect: Effect) -> Self:
        """The model with one more effect, or with an effect on more joints, at its null value.

        On joints where the effect is only in the background, it is removed from the background.

        Raises:
            InputError: the model has the effect already, or lacks the stage on which it acts.
            UnknownNameError: the effect names a joint that the model lacks.
        """
        if effect.acts_on not in self.stages:
            raise InputError(
                f"the effect '{effect.name}' acts on a {effect.acts_on}, which a model of base '{self.base}' lacks: "
                f"choose one that acts on {' or '.join(self.stages)}"
            )
        reachable = self.reachable(effect)
        if effect.joints and reachable == ("",):
            listed = ",".join(effect.joints)
            raise InputError(f"the effect '{effect.name}' acts on the {effect.acts_on}: leave out ':{listed}'")
        wanted = effect.joints or reachable
        unnamed = [joint for joint in self._joints_without_name(effect.name) if joint in wanted]
        if unnamed:
            return self.without_effect(effect.on(*unnamed).label).with_effect(effect)
        has = self.joints_with(effect.name)
        new = tuple(joint for joint in reachable if joint in wanted and joint not in has)
        if not new:
            raise InputError(f"the model already has the effect '{effect.label}'")
        joints = tuple(joint for joint in reachable if joint in has or joint in new)
        whole = effect.on(*(() if joints == reachable else joints))
        effects = [whole if e.name == effect.name else e for e in self.effects]
        added = [
            self.effect_parameter(quantity, effect.name, short, joint)
            for joint in new
            for short, quantity in effect.quantities.items()
        ]
        return self._with(effects if has else [*effects, whole], {**self.parameters, **{p.name: p for p in added}})

    def without_effect(self, name: str) -> Self:
        """The model without one effect, or without it on some joints: ``"<effect>:<joint>,<joint>"``.

        Raises:
            UnknownNameError: the model does not have the effect.
        """
        name, _, listed = name.partition(":")
        has = self.joints_with(name)
        if not has:
            raise UnknownNameError("effect of this model", name, [e.name for e in self.effects])
        gone = tuple(listed.split(",")) if listed else has
        for joint in gone:
            if joint not in has:
                raise UnknownNameError(f"joint with the effect '{name}'", joint, has)
        left = tuple(joint for joint in has if joint not in gone)
        kept = {n: p for n, p in self.parameters.items() if p.effect != name or p.joint in left}
        return self._with((e.on(*left) if e.name == name else e for e in self.effects if e.name != name or left), kept)

    def with_only(self, effects: Collection[str]) -> Self:
        """The model with these effects only; its parameters keep their order."""
        kept = tuple(effect for effect in self.effects if effect.name in effects)
        if len(kept) == len(self.effects):
            return self
        own = {n: p for n, p in self.parameters.items() if not p.effect or p.effect in effects}
        return self._with(kept, own)

    def _with(self, effects: Iterable[Effect], parameters: Mapping[str, Parameter]) -> Self:
        """The model with these effects and parameters, and with the part of its background that remains."""
        held = tuple(name for name in self.background.names if name in parameters) if self.background else ()
        background = replace(self.background, names=held) if self.background and held else None
        return replace(
            self, effects=tuple(effects), parameters=MappingProxyType(dict(parameters)), background=background
        )

    def with_background(self, width: float, values: Mapping[str, float], effects: Iterable[Effect]) -> Self:
        """The model with a new background: small values of effects on joints where the model does not name them.

        Args:
            width: prior standard deviation about their null values, in typical sizes.
            values: values by parameter name; other parameters of the same effect and joint get their null values.
            effects: definitions of the effects, which are added on the joints with values.

        Raises:
            InputError: the width is negative, a value is out of bounds, or it belongs to an effect that the model names
                on this joint.
            UnknownNameError: there is no such effect, joint or parameter.
        """
        if not 0.0 <= width < inf:
            raise InputError(f"width {width:g}: give a number that is not negative, in typical sizes")
        bare, known = self.named_only(), {effect.name: effect for effect in effects}
        joints: dict[str, list[str]] = {}
        for name in values:
            quantity, _, joint = name.partition("[")
            effect, joint = quantity.partition(".")[0], joint.removesuffix("]")
            if effect not in known:
                raise UnknownNameError("effect", effect, known)
            if joint in bare.joints_with(effect):
                where = f" on {joint}" if joint else ""
                raise InputError(f"{name}: the model names the effect '{effect}'{where}: write the value with its name")
            joints.setdefault(effect, []).append(joint)
        model = bare
        for effect, needed in joints.items():
            model = model.with_effect(known[effect].on(*(joint for joint in dict.fromkeys(needed) if joint)))
        own = {name: p for name, p in model.parameters.items() if name not in bare.parameters}
        settable = [name for name, p in own.items() if p.scope == "shared"]
        for name in values:
            if name not in settable:
                raise UnknownNameError("parameter", name, settable)
        held = {name: replace(p, value=float(values.get(name, p.value)), fitted=False) for name, p in own.items()}
        background = Background(float(width), tuple(held)) if held else None
        return replace(model.with_parameters(held), background=background)

    def named_only(self) -> Self:
        """The model without its background."""
        model = self
        for effect in self.effects:
            unnamed = self._joints_without_name(effect.name)
            if unnamed:
                model = model.without_effect(effect.on(*unnamed).label)
        return model

    @property
    def named_effects(self) -> tuple[Effect, ...]:
        """The effects that the model names, each on its named joints, without those of the background."""
        return self.named_only().effects

    def _joints_without_name(self, effect: str) -> tuple[str, ...]:
        """Joints where an effect is only in the background, ``("",)`` where its stage has no joints."""
        held = self.background.names if self.background is not None else ()
        return tuple(dict.fromkeys(p.joint for p in map(self._parameter, held) if p.effect == effect))

    @property
    def has_catalogue_stages(self) -> bool:
        """Whether its stages are those of the catalogue's effects; a user's own base may define another load."""
        return True

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """Effects that come with the base, besides the catalogue's."""
        return ()

    @property
    def robot(self) -> "Robot | None":
        """Robot whose joints the model describes; None for a model of anything else."""
        return None

    def motion_errors(self, recordings: "Sequence[tuple[Run, str]]") -> "tuple[RollOut, ...]":
        """Simulated against recorded motion in recordings, each with its role; empty for a model without joints."""
        del recordings
        return ()

    def reachable(self, effect: Effect) -> tuple[str, ...]:
        """Joints on which an effect can act, in the model's order; ``("",)`` where its stage has no joints.

        Raises:
            InputError: it cannot act on a joint that it names, or on any joint.
        """
        del effect
        return ("",)

    def effect_parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """A parameter of an effect on a joint, with the units and typical size that it has there."""
        return quantity.parameter(effect, short, joint)

    def joints_with(self, effect: str) -> tuple[str, ...]:
        """Joints on which the model has an effect; ``("",)`` where its stage has no joints; empty without it."""
        return next((e.joints or self.reachable(e) for e in self.effects if e.name == effect), ())

    def with_values(self, values: Mapping[str, float]) -> Self:
        """The model with other parameter values, in their units; standard deviations are removed."""
        return self.with_parameters({name: self._parameter(name).with_value(v) for name, v in values.items()})

    def with_parameters(self, changed: Mapping[str, Parameter]) -> Self:
        """The model with some parameters replaced."""
        for name in changed:
            self._parameter(name)
        return replace(self, parameters=MappingProxyType({**self.parameters, **changed}))

    def with_prior(self, name: str, mean: float, std: float) -> Self:
        """The model with a prior on a parameter: mean and standard deviation, in its unit."""
        known = replace(self._parameter(name), prior=Prior(mean, std), value=mean)
        return self.with_parameters({name: known})

    def with_fixed(self, *names: str) -> Self:
        """The model with these parameters fixed at their values in every fit."""
        return self.with_parameters({name: replace(self._parameter(name), fitted=False) for name in names})

    def with_candidates(self, effects: Iterable[Effect]) -> Self:
        """The model with all of `effects` that it lacks and can have, at their null values and not fitted."""
        model = self
        for effect in effects:
            if model.lacks(effect):
                had, there = set(model.names), model.joints_with(effect.name)
                new = (joint for joint in effect.joints or model.reachable(effect) if joint and joint not in there)
                model = model.with_effect(effect.on(*new))
                model = model.with_fixed(*(name for name in model.names if name not in had))
        return model

    def lacks(self, effect: Effect) -> bool:
        """Whether `with_effect` would change the model."""
        if effect.acts_on not in self.stages:
            return False
        return not set(effect.joints or self.reachable(effect)) <= set(self.joints_with(effect.name))

    @property
    def first_guesses(self) -> tuple[str, ...]:
        """Parameters whose values are only guesses; unidentified ones stay near the given values."""
        return ()

    def following(self, runs: Sequence[Run]) -> Self:
        """The model adapted to further quantities of recordings, such as a servo's commands; most are unchanged."""
        del runs
        return self

    def taking(self, run: Run) -> Run:
        """The run with those of its further quantities as channels that the model predicts or needs as input."""
        return run

    @property
    def hangs_from_gripper(self) -> bool:
        """Whether it is a load on a string, for which motions of the gripper can be designed."""
        return False

    @property
    def open_questions(self) -> tuple[str, ...]:
        """Open questions that recordings leave, with what would answer them: sentences without full stops."""
        return ()

    @property
    def told_beside(self) -> frozenset[str]:
        """Names of effects that are no candidates, because recordings state them or because they fit any recording.

        A user can still add them.
        """
        return frozenset()

    def reading(self, run: Run) -> Run:
        """The run with estimated channels that the model predicts: a servo's position error gives its torque."""
        return run

    def holding(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """A model that may lack effects which are not `needed`, where it predicts `runs` faster.

        At the null values of the effects that it lacks, it predicts the same; its parameters keep their order.
        """
        del runs
        return self.with_only(needed)

    def prepared(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run in the form for comparison with this model; prepare every run once, before its noise is estimated.

        For an arm the measured torques are low-passed and thinned out here, and the predictions for the returned run
        likewise. Other models use runs as they are.

        Args:
            run: a recording.
            beside: further recordings that show the properties of the sensors; by default this one alone.

        Raises:
            InputError: the run cannot be compared with this model.
        """
        del beside
        return run

    def jumps(self, run: Run) -> np.ndarray:
        """(j,) times, s, ascending, at which the prediction for a prepared run may jump."""
        del run
        return np.zeros(0)

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """Standard deviation of the compared samples, by channel of a prepared run, where it depends on (p,) `theta`.

        The noise of an arm's positions becomes torque through its inertias.
        """
        del run, theta
        return {}

    def parts(self, effect: str) -> Mapping[str, tuple[str, ...]]:
        """Names of an effect's parameters by joint; the joint is ``""`` where the effect has none."""
        return {
            joint: tuple(p.name for p in self.parameters.values() if p.effect == effect and p.joint == joint)
            for joint in self.joints_with(effect)
        }

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which a residual may depend, such as the swing angle or a joint's speed, over the run's time."""
        del run, theta
        return {}

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """Channels whose residual is a missing force, by name with the joint; empty for a model with states.

        A model with states lacks an acceleration, which its residual contains only through the motion.
        """
        del run
        return {}

    def _parameter(self, name: str) -> Parameter:
        if name not in self.parameters:
            raise UnknownNameError("parameter", name, self.names)
        return self.parameters[name]

    @abstractmethod
    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that this model predicts, in the order of the prediction.

        Raises:
            InputError: there is no such channel.
        """

    @abstractmethod
    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the channels of a run.

        Args:
            run: a recording; the channels that both it and the model have are predicted.
            theta: (p,) parameter values for this run, in the order of `names`.

        Raises:
            InputError: the run has no channel that this model predicts.
        """
