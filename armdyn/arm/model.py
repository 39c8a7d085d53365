"""The arm as a model: joint torques of a run, with exact sensitivities, for any composition of effects."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
import pinocchio as pin

from armdyn.arm.arm import CANNOT, Arm, find_arm
from armdyn.arm.bodies import OF_BASE, Bodies, MotionSamples
from armdyn.arm.carried import following
from armdyn.arm.composition import Change, JointFunctions, base_change, compose_joint
from armdyn.arm.drive_scale import identified_drives, telling
from armdyn.arm.drives import Servo, read_drives
from armdyn.arm.motion import motion_channels, torque_channels
from armdyn.arm.prediction import predict_at_states, predictor_of, prepared_once
from armdyn.arm.prepared import PreparedRun, torque_noise
from armdyn.arm.readings import with_readings
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError, at
from armdyn.model import Model, Prediction, join_channels
from armdyn.parameter import Parameter, Quantity
from armdyn.run import Channel, Run
from urdf.table_file import Check, read_as

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange


@dataclass(frozen=True, repr=False)
class ArmModel(Model):
    """Rigid bodies as the URDF has them, and effects.

    A parameter of an effect is ``"<effect>.<quantity>[<joint>]"``, or ``"<effect>.<quantity>"`` where the effect acts
    on the base, which stands in the place of a joint as ``""``.

    Attributes:
        arm: the joints and their links.
        drives: by the name of their kind, of joints that record what they were told rather than a torque.
    """

    arm: Arm
    drives: Mapping[str, Servo] = field(default_factory=lambda: MappingProxyType({}))

    base = "arm"
    linear = True

    @property
    def stages(self) -> tuple[str, ...]:
        """See `Model.stages`: drives are one where the model says what they are told."""
        return ("joint", "drive") if self.drives else ("joint",)

    @property
    def about(self) -> str:
        """See `Model.about`."""
        return f"arm {self.arm.robot.name}, {len(self.joints)} joints from {self.joints[0]} to {self.joints[-1]}"

    def described(self, folder: Path) -> Mapping[str, Any]:
        """See `Model.described`: which arm it is, its file as seen from the model's own, and its drives."""
        slides = dict(zip(self.arm.joints, self.arm.slides, strict=True))
        drives = {name: servo.entries(slides[servo.joints[0]]) for name, servo in self.drives.items()}
        own = {**super().described(folder), **({"drives": drives} if drives else {})}
        if self.arm.file is None:
            return own
        try:
            place = Path(os.path.relpath(self.arm.file, folder.resolve())).as_posix()
        except ValueError:  # on another drive
            place = str(self.arm.file)
        return {**own, "urdf": place}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints from base to tool; others of the URDF stay at their zero, or move as recorded."""
        return self.arm.driven

    def following(self, runs: Sequence[Run]) -> Self:
        """See `Model.following`: joints of the URDF that it leaves out and that move, and drives not known yet."""
        arm = following(self.arm, runs)
        drives = identified_drives(self.drives, arm, runs)
        if arm is self.arm and drives == self.drives:
            return self
        return replace(self, arm=arm, drives=MappingProxyType(drives))

    def reading(self, run: Run) -> Run:
        """See `Model.reading`: the torques that servos gave, by their own errors."""
        return with_readings(run, self.arm.joints, tuple(self.drives.values()))

    @property
    def open_questions(self) -> tuple[str, ...]:
        """See `Model.open_questions`: gains that nothing tells."""
        return tuple(
            f"[drives.{name}]: the recordings do not say how large its gain is, {servo.gain.value:.3g} ± "
            f"{servo.gain.std:.2g} {servo.gain.unit}: values of {', '.join(servo.joints)} are ratios to k_p, right per "
            f"{servo.gain.unit} alone. To tell it, {telling(self.arm, servo.joints)}"
            for name, servo in self.drives.items()
            if servo.gain is not None and not servo.determined
        )

    @property
    def told_beside(self) -> frozenset[str]:
        """See `Model.told_beside`: what a reading explains by itself, and what is said of all drives of a kind."""
        drives = self.drives.values()
        looked_for = {
            "servo_gain": any(servo.gain is None or servo.gain.std is not None for servo in drives),
            "command_delay": any(servo.delay is None for servo in drives),
            "supply_voltage": any(servo.supply is not None for servo in drives),
            "servo_damping": all(servo.law != "position" for servo in drives),
        }
        return OF_READING | {name for name, told in looked_for.items() if told}

    def servo(self, joint: str) -> Servo | None:
        """The drive of a joint, if it is declared."""
        return next((servo for servo in self.drives.values() if joint in servo.joints), None)

    @property
    def told(self) -> frozenset[str]:
        """Joints of the declared drives."""
        return frozenset(joint for servo in self.drives.values() for joint in servo.joints)

    def with_drives(self, table: Mapping[str, Any]) -> Self:
        """The model with drives as ``[drives]`` of a model file declares them; see `read_drives`."""
        slides = dict(zip(self.arm.joints, self.arm.slides, strict=True))
        return replace(self, drives=MappingProxyType(read_drives(table, slides))) if table else self

    def reachable(self, effect: Effect) -> tuple[str, ...]:
        """See `Model.reachable`; ``("",)`` for an effect on the base.

        Raises:
            InputError: it cannot act on these joints, or on this arm.
            UnknownNameError: it is meant for a joint that the arm lacks.
        """
        reachable = self.arm.within(effect.reach)
        if effect.name in OF_DRIVE or effect.acts_on == "drive":
            reachable = tuple(j for j in reachable if (j in self.told) == (effect.acts_on == "drive"))
        for joint in effect.joints:
            if joint not in self.joints:
                raise UnknownNameError("joint of the arm", joint, self.joints)
            if joint not in reachable:
                raise InputError(f"the effect '{effect.name}' cannot act on joint '{joint}': {CANNOT[effect.reach]}")
        return reachable

    def with_effect(self, effect: Effect) -> Self:
        """See `Model.with_effect`.

        Raises:
            InputError: this arm has no joint on which the effect can act, or not the joint that it names.
        """
        if effect.acts_on in self.stages and not self.reachable(effect):
            raise InputError(f"the effect '{effect.name}' cannot act on this arm: {CANNOT[effect.reach]}")
        return super().with_effect(effect)

    def effect_parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """See `Model.effect_parameter`."""
        return self.arm.parameter(quantity, effect, short, joint)

    def changes_link(self, names: Sequence[str]) -> bool:
        """See `Model.changes_link`: a payload and a link's own inertia do."""
        joint = self.parameters[names[0]].joint
        if not joint:
            return False
        i = self.arm.joints.index(joint)
        link, own = self._functions[i].link, [self._columns[i].index(self.names.index(name)) for name in names]
        return link is not None and bool(link.depends[own].any())

    def link_changes(
        self, theta: np.ndarray, covariance: np.ndarray, of_runs_alone: np.ndarray, free: np.ndarray
    ) -> "tuple[LinkChange, ...]":
        """Links that effects change; see `Model.link_changes`."""
        from armdyn.arm.links import link_changes

        return link_changes(self, theta, covariance, of_runs_alone, free)

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """See `Model.covariates`: position, velocity and acceleration of every joint."""
        del theta
        return motion_channels(run, self.arm.joints, self.arm.slides)

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """See `Model.force_channels`: the measured torques."""
        return {channel: channel.removeprefix("tau.") for channel in self.predicted_channels(run)}

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """See `Model.predicted_channels`: the measured torques of the arm's joints."""
        return torque_channels(run, self.arm.joints, self.arm.slides, self.arm.carried)

    def prepared(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """See `Model.prepared`; a run that is prepared already is returned as it is."""
        if isinstance(run, PreparedRun):
            return run
        self.predicted_channels(run)
        return prepared_once(run, self.arm, tuple(one.recording for one in beside))

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """See `Model.noise`."""
        if not isinstance(run, PreparedRun):
            return {}
        return torque_noise(run, self.rigid_at(theta), self.arm.model, self.arm.joints)

    def rigid_at(self, theta: np.ndarray) -> pin.Model:
        """The links and rotors as effects with (p,) `theta` leave them."""
        rigid, armature = self.arm.model.copy(), np.zeros(len(self.arm.joints))
        for i, change in self._bodies(theta).links.items():
            rigid.inertias[i + 1] = pin.Inertia.FromDynamicParameters(self.arm.described[i] + change)
        for joint, (name,) in self.parts(ROTOR).items():
            armature[self.arm.joints.index(joint)] = theta[self.names.index(name)]
        rigid.armature = armature
        return rigid

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """See `Model.predict`."""
        channels = self.predicted_channels(run)
        per_joint = [theta[columns] for columns in self._columns]
        bodies = self._bodies(theta)
        parts = []
        for name in channels:
            predictor = predictor_of(run, self.arm, run.channels[name], name)
            values, derivatives = predictor.predict(self._functions, per_joint, bodies)
            parts.append((name, run.channels[name].time, values, self._by_theta(derivatives, len(values))))
        return join_channels(parts)

    def at_states(self, stretch: MotionSamples) -> tuple[np.ndarray, np.ndarray]:
        """All torques at states that are known exactly and need not follow each other.

        Returns:
            (n, nj) torques; (n, nj, p) their derivatives.

        Raises:
            InputError: an effect makes a torque depend on what was before.
        """
        theta, count = self.theta(), len(stretch.time)
        per_joint, bodies = [theta[columns] for columns in self._columns], self._bodies(theta)
        found = predict_at_states(stretch, self._functions, per_joint, bodies)
        derivatives = [self._by_theta(by_joint, count) for _, by_joint in found]
        return np.column_stack([torques for torques, _ in found]), np.stack(derivatives, axis=1)

    def _by_theta(self, derivatives: Mapping[int, np.ndarray], count: int) -> np.ndarray:
        """(count, p) of the derivatives by the parameters of each joint and of the base."""
        found = np.zeros((count, len(self.names)))
        for joint, columns in derivatives.items():
            found[:, self._base_columns if joint == OF_BASE else self._columns[joint]] = columns
        return found

    def changed_links(self, theta: np.ndarray) -> Mapping[int, tuple[np.ndarray, np.ndarray]]:
        """By index of the joint whose link effects can change: (10,) change at (p,) `theta`, (10, p) derivatives."""
        bodies = self._bodies(theta)
        found = {}
        for i, change in bodies.links.items():
            derivatives = np.zeros((len(change), len(theta)))
            derivatives[:, self._columns[i]] = bodies.derivatives[i]
            found[i] = change, derivatives
        return found

    @property
    def remembers(self) -> bool:
        """Whether an effect has states of its own."""
        return any(functions.remembers for functions in self._functions)

    def link_parameters(self) -> Mapping[str, np.ndarray]:
        """By joint: (10,) inertial parameters of the link that it moves, effects included; see `rigid`."""
        changes, described = self._bodies(self.theta()).links, self.arm.described
        return {
            joint: described[i] + changes.get(i, np.zeros(len(described[i]))) for i, joint in enumerate(self.arm.joints)
        }

    def gravity(self) -> np.ndarray:
        """(3,) acceleration of free fall in the frame of the base, m/s^2, effects included."""
        return self.gravity_at(self.theta())

    def gravity_at(self, theta: np.ndarray) -> np.ndarray:
        """(3,) the same at (p,) `theta`."""
        described, change = np.array(self.arm.model.gravity.linear), self._bodies(theta).gravity
        return described if change is None else described + change

    def _bodies(self, theta: np.ndarray) -> Bodies:
        base = None
        if self._base is not None:
            base = self._base, np.array(self.arm.model.gravity.linear), theta[self._base_columns]
        return Bodies(self._functions, [theta[columns] for columns in self._columns], self.arm.shapes, base)

    @cached_property
    def _base(self) -> Change | None:
        effects = [e for e in self.effects if e.reach == "base"]
        return base_change(effects) if effects else None

    @cached_property
    def _base_columns(self) -> list[int]:
        """Where the parameters of effects on the base are in the model's vector."""
        return [] if self._base is None else [self.names.index(name) for name in self._base.names]

    @cached_property
    def _functions(self) -> tuple[JointFunctions, ...]:
        return tuple(
            compose_joint([e for e in self.effects if joint in self.joints_with(e.name)]) for joint in self.arm.joints
        )

    @cached_property
    def _columns(self) -> tuple[list[int], ...]:
        """Per joint: where its parameters are in the model's vector."""
        index = {name: i for i, name in enumerate(self.names)}
        return tuple(
            [index[f"{name}[{joint}]"] for name in functions.names]
            for joint, functions in zip(self.arm.joints, self._functions, strict=True)
        )


OF_DRIVE = frozenset({"torque_gain", "torque_delay"})
"""Effects that are what a declared drive's table holds: another gain is another table."""
OF_READING = frozenset({"torque_limit"})
"""Effects of a joint that are looked for of all drives of a kind: where they saturate; see `drive_scale`."""
ROTOR = "rotor_inertia"
"""The effect that adds to the inertia of a joint by itself."""


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


_Name = Annotated[str, Check(bool, "write a name")]


@dataclass(frozen=True)
class Keys:
    """Keys of a model file that say which arm it is; see `arm_model`."""

    urdf: _Name | None = None
    robot: _Name | None = None
    joints: tuple[str, ...] | None = None
    tool: _Name | None = None
    drives: dict[str, Any] = field(default_factory=dict)


KEYS = tuple(key.name for key in fields(Keys))


def read_base(table: Mapping[str, Any], folder: Path) -> tuple[ArmModel, dict[str, Any]]:
    """The model without effects, and the keys that say which arm it is.

    Args:
        table: of the file.
        folder: where a path in it begins.

    Raises:
        InputError: not exactly one of both is given, or the arm cannot be used.
    """
    description = {key: table[key] for key in KEYS if key in table}
    with at("the arm"):
        keys = read_as(Keys, description)
    if (keys.urdf is None) == (keys.robot is None):
        raise InputError('an arm needs either urdf = "path" or robot = "baxter"')
    # Where the URDF is depends on where the model is written: `ArmModel.described` says it.
    rest = {key: value for key, value in description.items() if key not in ("urdf", "drives")}
    urdf = None if keys.urdf is None else folder / keys.urdf
    model = arm_model(urdf, keys.robot, keys.joints, tool=keys.tool)
    return model.with_drives(keys.drives), rest
