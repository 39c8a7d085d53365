"""The effects and parameters of a model. A model is never changed in place: methods return changed copies."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from types import MappingProxyType
from typing import Self

import numpy as np

from armdyn.document import Column, Columns, Table, attribute_columns
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.parameter import Parameter, Prior, Quantity


@dataclass(frozen=True)
class Background:
    """Small values of unnamed effects of a model: together they improve the prediction, but none of them is reported.

    Attributes:
        width: standard deviation of the prior about the null values, in units of each parameter's `typical`.
        names: names of the parameters; later fits do not change them.
        named_only: values, by parameter name, of the named effects fitted without the background; empty where unknown.
    """

    width: float
    names: tuple[str, ...]
    named_only: Mapping[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """A short name such as ``"background of 57 small values"``."""
        count = len(self.names)
        return f"background of {count} small value{'' if count == 1 else 's'}"

    @property
    def sentence(self) -> str:
        """One sentence for a reader: how many small values a report does not list, and the width of their prior."""
        return f"Not listed: a {self.label}, of a width of {self.width:.3g} typical sizes."


@dataclass(frozen=True, repr=False)
class EffectModel(ABC):
    """Base class of every model: its effects and parameters, and methods that return copies with other ones.

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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of every parameter vector."""
        return tuple(self.parameters)

    def value(self, name: str) -> float:
        """Value of the parameter `name`, in the parameter's unit."""
        return self._parameter(name).value

    def theta(self) -> np.ndarray:
        """Values of all parameters as a vector (p,), in the order of `names`."""
        return np.array([p.value for p in self.parameters.values()])

    @property
    @abstractmethod
    def base(self) -> str:
        """Name of the base model to which effects are added, such as ``"arm"`` or ``"pendulum"``."""

    @property
    @abstractmethod
    def stages(self) -> tuple[str, ...]:
        """Names of the stages (parts of the equations, such as ``"joint"``) on which effects of this model can act."""

    @property
    def named_effects(self) -> tuple[Effect, ...]:
        """The effects that reports list, each on its joints, without the small values of the background."""
        return self.without_background().effects

    def without_background(self) -> Self:
        """A copy of the model without its background of small values."""
        model = self
        for effect in self.effects:
            unnamed = self._joints_without_name(effect.name)
            if unnamed:
                model = model.without_effect(effect.on(*unnamed).label)
        return model

    def with_named_effects_only(self) -> Self:
        """A copy without the background, whose named effects have the values that were fitted without it."""
        alone = self.background.named_only if self.background is not None else {}
        model = self.without_background()
        return model.with_parameters(
            {name: replace(p, value=alone[name]) for name, p in model.parameters.items() if name in alone}
        )

    def _joints_without_name(self, effect: str) -> tuple[str, ...]:
        """Joints where an effect is only in the background, ``("",)`` where its stage has no joints."""
        held = self.background.names if self.background is not None else ()
        return tuple(dict.fromkeys(p.joint for p in map(self._parameter, held) if p.effect == effect))

    def joints_effect_can_act_on(self, effect: Effect) -> tuple[str, ...]:
        """Joints on which an effect can act, in the model's order; ``("",)`` where its stage has no joints.

        Raises:
            InputError: the effect names a joint on which it cannot act, or it can act on no joint.
        """
        del effect
        return ("",)

    def effect_parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """Make the parameter `short` of an effect on a joint, in the unit and typical size for that joint.

        Args:
            quantity: declaration of the parameter by the effect.
            effect: name of the effect.
            short: name of the parameter within the effect.
            joint: name of the joint, ``""`` where the effect has none.
        """
        return quantity.parameter(effect, short, joint)

    def joints_having_effect(self, effect: str) -> tuple[str, ...]:
        """Joints on which the model has an effect.

        ``("",)`` where the effect's stage has no joints; empty where the model does not have the effect.
        """
        return next((e.joints or self.joints_effect_can_act_on(e) for e in self.effects if e.name == effect), ())

    def parameter_names_by_joint(self, effect: str) -> Mapping[str, tuple[str, ...]]:
        """Names of an effect's parameters by joint; the joint is ``""`` where the effect has none."""
        return {
            joint: tuple(p.name for p in self.parameters.values() if p.effect == effect and p.joint == joint)
            for joint in self.joints_having_effect(effect)
        }

    def can_add_effect(self, effect: Effect) -> bool:
        """Whether the model can have an effect that it does not have yet, on all of its joints or on some."""
        if effect.acts_on not in self.stages:
            return False
        return not set(effect.joints or self.joints_effect_can_act_on(effect)) <= set(
            self.joints_having_effect(effect.name)
        )

    def with_effect(self, effect: Effect) -> Self:
        """A copy of the model with one more effect, or with an effect on more joints, at its null value.

        Small values of this effect on these joints are removed from the background.

        Raises:
            InputError: the model has the effect already, or lacks the stage on which it acts.
            UnknownNameError: the effect names a joint that the model lacks.
        """
        if effect.acts_on not in self.stages:
            raise InputError(
                f"the effect '{effect.name}' acts on a {effect.acts_on}, which a model of base '{self.base}' lacks: "
                f"choose one that acts on {' or '.join(self.stages)}"
            )
        reachable = self.joints_effect_can_act_on(effect)
        if effect.joints and reachable == ("",):
            listed = ",".join(effect.joints)
            raise InputError(f"the effect '{effect.name}' acts on the {effect.acts_on}: leave out ':{listed}'")
        wanted = effect.joints or reachable
        unnamed = [joint for joint in self._joints_without_name(effect.name) if joint in wanted]
        if unnamed:
            return self.without_effect(effect.on(*unnamed).label).with_effect(effect)
        has = self.joints_having_effect(effect.name)
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
        """A copy of the model without one effect, or without it on some joints: ``"<effect>:<joint>,<joint>"``.

        Raises:
            UnknownNameError: the model does not have the effect.
        """
        name, _, listed = name.partition(":")
        has = self.joints_having_effect(name)
        if not has:
            raise UnknownNameError("effect of this model", name, [e.name for e in self.effects])
        gone = tuple(listed.split(",")) if listed else has
        for joint in gone:
            if joint not in has:
                raise UnknownNameError(f"joint with the effect '{name}'", joint, has)
        left = tuple(joint for joint in has if joint not in gone)
        kept = {n: p for n, p in self.parameters.items() if p.effect != name or p.joint in left}
        return self._with((e.on(*left) if e.name == name else e for e in self.effects if e.name != name or left), kept)

    def with_only_effects(self, effects: Collection[str]) -> Self:
        """A copy of the model that has only the effects with these names; its parameters keep their order."""
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

    def with_background(
        self,
        width: float,
        values: Mapping[str, float],
        effects: Iterable[Effect],
        named_only: Mapping[str, float] = MappingProxyType({}),
    ) -> Self:
        """A copy of the model with a new background: small values of effects that reports do not list.

        Args:
            width: standard deviation of the prior about the null values, in units of each parameter's `typical`.
            values: values by parameter name; other parameters of the same effect and joint get their null values.
            effects: definitions of the effects, which are added on the joints with values.
            named_only: values of the named effects fitted without the background.

        Raises:
            InputError: the width is negative, a value is out of bounds, or the model already lists the effect on this
                joint.
            UnknownNameError: there is no such effect, joint or parameter.
        """
        if not 0.0 <= width < inf:
            raise InputError(f"width {width:g}: give a number that is not negative, in typical sizes")
        bare, known = self.without_background(), {effect.name: effect for effect in effects}
        joints: dict[str, list[str]] = {}
        for name in values:
            quantity, _, joint = name.partition("[")
            effect, joint = quantity.partition(".")[0], joint.removesuffix("]")
            if effect not in known:
                raise UnknownNameError("effect", effect, known)
            if joint in bare.joints_having_effect(effect):
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
        for name in named_only:
            if name not in bare.parameters:
                raise UnknownNameError("parameter of a named effect", name, list(bare.parameters))
        background = Background(float(width), tuple(held), dict(named_only)) if held else None
        return replace(model.with_parameters(held), background=background)

    def with_fixed_null_effects(self, effects: Iterable[Effect]) -> Self:
        """A copy of the model with all of `effects` that it can have, the new ones at their null values and fixed."""
        model = self
        for effect in effects:
            if model.can_add_effect(effect):
                had, there = set(model.names), model.joints_having_effect(effect.name)
                new = (
                    joint
                    for joint in effect.joints or model.joints_effect_can_act_on(effect)
                    if joint and joint not in there
                )
                model = model.with_effect(effect.on(*new))
                model = model.with_fixed(*(name for name in model.names if name not in had))
        return model

    def with_values(self, values: Mapping[str, float]) -> Self:
        """A copy of the model with other values of some parameters, in their units, without standard deviations."""
        return self.with_parameters({name: self._parameter(name).with_value(v) for name, v in values.items()})

    def with_parameters(self, changed: Mapping[str, Parameter]) -> Self:
        """A copy of the model in which some parameters, given by name, are replaced."""
        for name in changed:
            self._parameter(name)
        return replace(self, parameters=MappingProxyType({**self.parameters, **changed}))

    def with_prior(self, name: str, mean: float, std: float) -> Self:
        """A copy of the model with a normal prior on a parameter: mean and standard deviation, in its unit."""
        known = replace(self._parameter(name), prior=Prior(mean, std), value=mean)
        return self.with_parameters({name: known})

    def with_fixed(self, *names: str) -> Self:
        """A copy of the model in which no fit changes the parameters `names`."""
        return self.with_parameters({name: replace(self._parameter(name), fitted=False) for name in names})

    def background_table(self) -> Mapping[str, Callable[[], Columns]]:
        """The values of the model's background as a table for `Document.data`; empty without a background."""
        return {} if self.background is None else {"background": self._background_columns}

    def _background_columns(self) -> Columns:
        held = [self.parameters[name] for name in self.background.names] if self.background is not None else []
        columns = [Column("parameter", [p.name for p in held]), *attribute_columns(held, effect="", joint="", value="")]
        sizes = [(p.value - p.null) / p.typical for p in held]
        columns += [*attribute_columns(held, unit=""), Column("typical_sizes", sizes)]
        return Table(columns).values

    def _parameter(self, name: str) -> Parameter:
        if name not in self.parameters:
            raise UnknownNameError("parameter", name, self.names)
        return self.parameters[name]
