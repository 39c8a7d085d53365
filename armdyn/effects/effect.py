"""The class of a physical effect, and the decorator that makes one from a short function."""

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, TypeVar

from armdyn.errors import InputError
from armdyn.parameter import Parameter, Quantity, RecordedColumn, missing_channels

Reach = Literal["every", "turning", "coupled", "last", "base"]
"""Joints on which an effect can act: every joint, those that turn, those with a neighbour of the same kind towards the
base, or the last one; ``"base"`` is the base of the arm itself."""
Physics = TypeVar("Physics")


@dataclass(frozen=True, eq=False)  # effects are compared by identity, since two functions cannot be compared
class Effect:
    """One piece of physics that can be added to a model by name.

    Attributes:
        name: the catalogue's name.
        acts_on: name of the stage (part of the equations) that it changes, such as ``"joint"``.
        quantities: declarations of its parameters, by short name.
        columns: recorded quantities that it uses, such as a temperature, by argument of its function.
        summary: one sentence that describes it.
        source: source of the equation.
        function: a pure function ``(stage, **parameters, **columns) -> stage``.
        reach: joints on which it can act.
        joints: joints on which it acts, in the order of the arm; empty for all within its reach.
        needs: channels of which a recording must contain one to show the effect; empty where any channel does.
    """

    name: str
    acts_on: str
    quantities: Mapping[str, Quantity]
    summary: str
    source: str
    function: Callable[..., Any]
    reach: Reach = "every"
    joints: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    columns: Mapping[str, RecordedColumn] = field(default_factory=dict)

    @property
    def equation(self) -> str:
        """The effect's equation: the first line of its function's docstring; without a docstring, its summary."""
        return (self.function.__doc__ or self.summary).strip().split("\n")[0].rstrip(".")

    @property
    def in_joint(self) -> bool:
        """Whether it acts on joints of an arm or on their drives, and not on its base or a sensor that it carries."""
        return self.acts_on in ("joint", "drive") and self.reach != "base"

    def is_visible_in(self, channels: Collection[str]) -> bool:
        """Whether recordings of these channels can show the effect: an angle cannot show a load cell's lag."""
        return not self.missing_channels(channels)

    def missing_channels(self, channels: Collection[str]) -> tuple[str, ...]:
        """Channels of which one must be recorded in addition to `channels` to show the effect; empty if none must."""
        lacking = [missing_channels(channels, (column.name,)) for column in self.columns.values()]
        lacking.append(missing_channels(channels, self.needs))
        own = [missing_channels(channels, q.needs, q.beside) for q in self.quantities.values()]
        if all(own):  # one of these channels is enough
            lacking.append(tuple(dict.fromkeys(name for names in own for name in names)))
        return next((names for names in lacking if names), ())

    @cached_property
    def stage_class(self) -> type:
        """Class of the stage, from the annotation of the function's first argument; `object` without an annotation."""
        said = next(iter(inspect.signature(self.function).parameters.values())).annotation
        return said if isinstance(said, type) and said is not inspect.Parameter.empty else object

    @property
    def label(self) -> str:
        """Label ``"<name>"``, or ``"<name>:<joint>,<joint>"`` where the effect acts on these joints only."""
        return f"{self.name}:{','.join(self.joints)}" if self.joints else self.name

    def on(self, *joints: str) -> "Effect":
        """A copy of the effect that acts on these joints only, or on all within its reach where none is given."""
        if joints not in self._elsewhere:
            made = replace(self, joints=joints)
            made.__dict__["_elsewhere"] = self._elsewhere
            self._elsewhere.setdefault(joints, made)
        return self._elsewhere[joints]

    @cached_property
    def _elsewhere(self) -> dict[tuple[str, ...], "Effect"]:
        """Cache of copies by joints: each copy is made once, as derived results are stored by the effect's identity."""
        return {self.joints: self}

    def apply(
        self,
        stage: Physics,
        parameters: Mapping[str, Any],
        recorded: Mapping[RecordedColumn, Any] = MappingProxyType({}),
    ) -> Physics:
        """Apply the effect to a stage, and return the changed stage.

        Args:
            stage: the stage `acts_on`.
            parameters: expressions of the effect's parameters by full name, ``"<effect>.<quantity>"``.
            recorded: expressions of recorded quantities; a missing one has its usual value.

        Raises:
            InputError: the effect's function fails, or does not return a stage.
        """
        values = {short: parameters[f"{self.name}.{short}"] for short in self.quantities}
        values |= {argument: recorded.get(column, column.usual) for argument, column in self.columns.items()}
        try:
            changed = self.function(stage, **values)
        except (AttributeError, TypeError, ValueError, ZeroDivisionError, NotImplementedError) as error:
            fault = f"{type(error).__name__}: {error}"
            raise InputError(f"the effect '{self.name}' fails with {fault}: correct its file") from error
        if not isinstance(changed, type(stage)):
            kind, given = type(changed).__name__, type(stage).__name__.lower()
            raise InputError(
                f"the effect '{self.name}' returns a {kind}: return the {given} that it was given, with something added"
            )
        return changed

    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's parameters with their full names, at their null values."""
        return tuple(q.parameter(self.name, short) for short, q in self.quantities.items())


def recorded_columns(effects: Iterable[Effect]) -> tuple[RecordedColumn, ...]:
    """Recorded quantities that some effects use, such as a temperature, each once."""
    return tuple(dict.fromkeys(column for effect in effects for column in effect.columns.values()))


def effect(
    name: str | None = None,
    acts_on: str | None = None,
    *,
    summary: str,
    source: str,
    reach: Reach = "every",
    needs: tuple[str, ...] = (),
) -> Callable[[Callable[..., Physics]], Effect]:
    """Decorator that makes an `Effect` of a function, whose first argument is the stage on which the effect acts.

    Every other argument is a parameter of the effect, declared by a default `quantity(...)`, or a recorded quantity,
    declared by a default such as ``column("extra.temperature", "K", usual=293.15)``. By default the effect has the
    function's name, and the stage has the name of the first argument.

    ```python
    @effect(summary="air drag in proportion to speed", source="Stokes 1851")
    def linear_drag(load: Load, coefficient: Expression = quantity("N s/m", typical=5e-3, lower=0)) -> Load:
        return load.with_force(-coefficient * load.velocity)
    ```

    Raises:
        InputError: an argument declares neither a quantity nor a column.
    """

    def make(function: Callable[..., Physics]) -> Effect:
        called = function.__name__ if name is None else name
        stage, *arguments = inspect.signature(function).parameters.values()
        columns = {a.name: a.default for a in arguments if isinstance(a.default, RecordedColumn)}
        read = tuple(column.name for column in columns.values())
        quantities = {}
        for argument in (a for a in arguments if a.name not in columns):
            if not isinstance(argument.default, Quantity):
                raise InputError(
                    f"effect '{called}': argument '{argument.name}' needs a default such as "
                    'quantity("N", typical=1.0)'
                )
            quantities[argument.name] = replace(argument.default, needs=argument.default.needs or read)
        at = stage.name if acts_on is None else acts_on
        declared = MappingProxyType(quantities)
        return Effect(
            called, at, declared, summary, source, function, reach,
            needs=needs, columns=MappingProxyType(columns),
        )  # fmt: skip

    return make
