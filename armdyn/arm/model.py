"""The arm as a model: joint torques of a run, with exact sensitivities, for any composition of effects."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Self

import numpy as np

from armdyn.arm import recorded
from armdyn.arm.arm import BASE, Arm, find_arm
from armdyn.arm.bodies import OF_BASE, Bodies
from armdyn.arm.composition import BaseFunction, JointFunctions, compose_joint
from armdyn.arm.motion import measured_motion
from armdyn.arm.prepared import PreparedRun
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.model import Bend, Model, Prediction
from armdyn.parameter import Parameter
from armdyn.preparation import Preparation
from armdyn.run import Channel, Run


@dataclass(frozen=True)
class ArmModel(Model):
    """Rigid bodies as the URDF has them, and effects.

    A parameter of an effect is ``"<effect>.<quantity>[<joint>]"``, or ``"<effect>.<quantity>"`` where the effect acts
    on the base, which stands in the place of a joint as ``""``.

    Attributes:
        arm: the joints and their links.
    """

    arm: Arm

    base = "arm"
    linear = True
    stages = ("joint",)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints from base to tool; every other joint of the URDF stays at its zero."""
        return self.arm.joints

    def with_effect(self, effect: Effect) -> Self:
        """The model with one effect more, or with one that it has on more joints, at its null value.

        Raises:
            InputError: the model has it on all these joints already, or it cannot act on them.
            UnknownNameError: it is meant for a joint that the arm lacks.
        """
        if effect.acts_on != "joint":
            return super().with_effect(effect)  # which says what is wrong
        reachable = self.arm.within(effect.reach)
        for joint in effect.joints:
            if joint not in self.joints:
                raise UnknownNameError("joint of the arm", joint, self.joints)
            if joint not in reachable:
                raise InputError(f"the effect '{effect.name}' cannot act on joint '{joint}': {_REASON[effect.reach]}")
        if not reachable:
            raise InputError(f"the effect '{effect.name}' cannot act on this arm: {_REASON[effect.reach]}")
        has = self.joints_with(effect.name)
        wanted = effect.joints or reachable
        new = tuple(joint for joint in reachable if joint in wanted and joint not in has)
        if not new:
            raise InputError(f"the model already has the effect '{effect.label}'")
        joints = tuple(joint for joint in reachable if joint in has or joint in new)
        whole = effect.on(*(() if joints == reachable else joints))
        effects = [whole if e.name == effect.name else e for e in self.effects]
        added = {
            parameter.name: parameter
            for joint in new
            for short, quantity in effect.quantities.items()
            for parameter in [self.arm.parameter(quantity, f"{effect.name}.{short}", joint)]
        }
        return replace(
            self,
            effects=tuple(effects if has else [*effects, whole]),
            parameters=MappingProxyType({**self.parameters, **added}),
        )

    def without_effect(self, name: str) -> Self:
        """The model with one effect less, or ``"<effect>:<joint>,<joint>"`` with one on fewer joints.

        Raises:
            UnknownNameError: the model does not have it.
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
        dropped = {p for joint in gone for p in self.parts(name)[joint]}
        return replace(
            self,
            effects=tuple(e.on(*left) if e.name == name else e for e in self.effects if e.name != name or left),
            parameters=MappingProxyType({k: p for k, p in self.parameters.items() if k not in dropped}),
        )

    def lacks(self, effect: Effect) -> bool:
        """See `Model.lacks`."""
        if effect.acts_on != "joint":
            return False
        wanted = effect.joints or self.arm.within(effect.reach)
        return not set(wanted) <= set(self.joints_with(effect.name))

    def joints_with(self, effect: str) -> tuple[str, ...]:
        """Joints on which the model has an effect; ``""`` for the base."""
        found = [e.joints or self.arm.within(e.reach) for e in self.effects if e.name == effect]
        return found[0] if found else ()

    def holding(self, needed: Collection[str]) -> Self:
        """See `Model.holding`; every effect costs time, so that only those needed are kept."""
        kept = tuple(effect for effect in self.effects if effect.name in needed)
        if len(kept) == len(self.effects):
            return self
        names = {effect.name for effect in kept}
        own = {n: p for n, p in self.parameters.items() if n.partition(".")[0] in names}
        return replace(self, effects=kept, parameters=MappingProxyType(own))

    def parts(self, effect: str) -> Mapping[str, tuple[str, ...]]:
        """See `Model.parts`."""
        return {
            joint: tuple(n for n in self.names if n.startswith(f"{effect}.") and n.endswith(_place(joint)))
            for joint in self.joints_with(effect)
        }

    def bend(self, names: Sequence[str], theta: np.ndarray) -> Bend | None:
        """See `Model.bend`: what changes a link acts as a deformation of it does, through its inertial parameters."""
        joint = names[0].partition("[")[2].removesuffix("]")
        through = self.parts(DEFORMATION).get(joint, ())
        if not through:
            return None
        i = self.joints.index(joint)
        columns, link = self._columns[i], self._functions[i].link
        here = theta[columns]
        own, others = ([columns.index(self.names.index(name)) for name in of] for of in (names, through))
        if link is None or not link.depends[own].all():
            return None
        value, slopes = link.change(self.arm.shapes[i], here)
        inverse = np.linalg.inv(slopes[:, others])

        def bent(change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            there = here.copy()
            there[own] += change
            inertial, derivatives = link.change(self.arm.shapes[i], there)
            return inverse @ (inertial - value), inverse @ derivatives[:, own]

        return Bend(tuple(through), bent)

    def circumstances(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """See `Model.circumstances`: position, velocity and acceleration of every joint."""
        del theta
        motion = measured_motion(recorded.original(run), self.joints)
        first = recorded.original(run).channels[f"q.{self.joints[0]}"]
        time = first.time[(first.time >= motion.start) & (first.time <= motion.end)]
        at = motion.at(time)
        found = {}
        for i, joint in enumerate(self.joints):
            unit = "m" if self.arm.slides[i] else "rad"
            for kind, values, per in (("q", at.q, ""), ("v", at.v, "/s"), ("a", at.a, "/s^2")):
                found[f"{kind}.{joint}"] = Channel(time, values[:, i], f"{unit}{per}")
        return found

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """See `Model.predicted_channels`: the measured torques of the arm's joints."""
        channels = tuple(f"tau.{joint}" for joint in self.joints if f"tau.{joint}" in run.channels)
        where = run.source or run.name
        if not channels:
            raise InputError(
                f"{where}: holds no torque of {', '.join(self.joints)}, so there is nothing to compare: record "
                "'tau.<joint>'"
            )
        for i, joint in enumerate(self.joints):
            if f"q.{joint}" not in run.channels:
                raise InputError(
                    f"{where}: holds no 'q.{joint}', the position of a joint of the arm: record it, or choose the "
                    "arm's joints without it"
                )
            if (run.channels[f"q.{joint}"].unit == "m") != self.arm.slides[i]:
                moves = "slides" if self.arm.slides[i] else "turns"
                raise InputError(
                    f"{where}: 'q.{joint}' is in {run.channels[f'q.{joint}'].unit}, but the joint {moves}: mend the "
                    "column's unit"
                )
        return channels

    def prepared(self, run: Run) -> Run:
        """See `Model.prepared`; a run that is prepared already is returned as it is."""
        if isinstance(run, PreparedRun):
            return run
        return recorded.prepared(run, self.arm, self.predicted_channels(run))

    def recording(self, run: Run) -> Run:
        """See `Model.recording`."""
        return recorded.original(run)

    def preparations(self, run: Run) -> Mapping[str, Preparation]:
        """See `Model.preparations`."""
        return run.preparations if isinstance(run, PreparedRun) else {}

    def stated_noise(self, run: Run) -> Mapping[str, float]:
        """See `Model.stated_noise`."""
        return recorded.original(run).noise

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """See `Model.predict`."""
        channels = self.predicted_channels(run)
        per_joint = [theta[columns] for columns in self._columns]
        bodies = self._bodies(theta)
        blocks, slices, stamps, first = [], {}, [], 0
        total = sum(len(run.channels[name]) for name in channels)
        sensitivities = np.zeros((total, len(theta)))
        for name in channels:
            predictor = recorded.predictor(self.arm, run, run.channels[name], name)
            values, derivatives = predictor.predict(self._functions, per_joint, bodies)
            rows = slice(first, first + len(values))
            for joint, columns in derivatives.items():
                where = self._base_columns if joint == OF_BASE else self._columns[joint]
                sensitivities[rows, where] = columns
            blocks.append(values)
            stamps.append(run.channels[name].time)
            slices[name] = rows
            first = rows.stop
        return Prediction(channels, slices, np.concatenate(stamps), np.concatenate(blocks), sensitivities)

    def link_parameters(self) -> Mapping[str, np.ndarray]:
        """By joint: (10,) inertial parameters of the link that it moves, effects included; see `inertia`."""
        changes, described = self._bodies(self.theta()).links, self.arm.described
        return {
            joint: described[i] + changes.get(i, np.zeros(len(described[i]))) for i, joint in enumerate(self.joints)
        }

    def changed_links(self, theta: np.ndarray) -> Mapping[int, tuple[np.ndarray, np.ndarray]]:
        """By index of the joint whose link effects can change: (10,) change at (p,) `theta`, (10, p) derivatives."""
        bodies = self._bodies(theta)
        found = {}
        for i, change in bodies.links.items():
            derivatives = np.zeros((len(change), len(theta)))
            derivatives[:, self._columns[i]] = bodies.derivatives[i]
            found[i] = change, derivatives
        return found

    def gravity(self) -> np.ndarray:
        """(3,) acceleration of free fall in the frame of the base, m/s^2, effects included."""
        described, change = np.array(self.arm.model.gravity.linear), self._bodies(self.theta()).gravity
        return described if change is None else described + change

    def _bodies(self, theta: np.ndarray) -> Bodies:
        base = None
        if self._base is not None:
            base = self._base, np.array(self.arm.model.gravity.linear), theta[self._base_columns]
        return Bodies(self._functions, [theta[columns] for columns in self._columns], self.arm.shapes, base)

    @cached_property
    def _base(self) -> BaseFunction | None:
        effects = [e for e in self.effects if e.reach == "base"]
        return BaseFunction(effects) if effects else None

    @cached_property
    def _base_columns(self) -> list[int]:
        """Where the parameters of effects on the base are in the model's vector."""
        return [] if self._base is None else [self.names.index(name) for name in self._base.names]

    @cached_property
    def _functions(self) -> tuple[JointFunctions, ...]:
        return tuple(
            compose_joint([e for e in self.effects if joint in (e.joints or self.arm.within(e.reach))])
            for joint in self.joints
        )

    @cached_property
    def _columns(self) -> tuple[list[int], ...]:
        """Per joint: where its parameters are in the model's vector."""
        index = {name: i for i, name in enumerate(self.names)}
        return tuple(
            [index[f"{name}[{joint}]"] for name in functions.names]
            for joint, functions in zip(self.joints, self._functions, strict=True)
        )


DEFORMATION = "link_inertia"
"""The effect whose parameters span all that can change in a link."""


def _place(joint: str) -> str:
    """How the names of parameters end that belong to a joint."""
    return "" if joint == BASE else f"[{joint}]"


_REASON = {
    "every": "the arm has no joint",
    "turning": "it acts on joints that turn",
    "coupled": "it acts on joints whose neighbour towards the base is of the same kind",
    "last": "it acts on the last joint of an arm",
    "base": "it acts on the base of the arm; leave out the joint",
}


def arm_model(
    urdf: str | Path | None = None,
    robot: str | None = None,
    joints: Sequence[str] | None = None,
    effects: Iterable[Effect] = (),
    *,
    tool: str | None = None,
) -> ArmModel:
    """An arm with effects at their null values.

    Args:
        urdf: path of its URDF, or
        robot: name of a known robot.
        joints: names from base to tool; the longest chain of the URDF, or the known robot's arm, when not given. All
            others are locked at their zero.
        effects: to start with.
        tool: the link that carries the tool.

    Raises:
        InputError: the description cannot be used, or lacks a joint.
    """
    model = ArmModel(
        effects=(), parameters=MappingProxyType[str, Parameter]({}), arm=find_arm(urdf, robot, joints, tool)
    )
    for item in effects:
        model = model.with_effect(item)
    return model
