"""The model of an arm: it predicts the joint torques of a run, with exact derivatives, for any set of effects."""

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import pinocchio as pin

from armdyn.arm.arm import REASONS_AGAINST_EFFECT, Arm, load_arm_description
from armdyn.arm.bodies import BASE_INDEX, MotionSamples, RigidBodyChanges
from armdyn.arm.carried import with_joints_moving_as_recorded
from armdyn.arm.composition import (
    InertialOrGravityChange,
    JointTorqueFunctions,
    gravity_change_by_effects,
    torque_functions_with_effects,
)
from armdyn.arm.drive_gain.drive_scale import drives_with_identified_gains, recordings_that_identify_gains
from armdyn.arm.drives import Servo, read_drives
from armdyn.arm.links import LinkInertiaChange, link_inertia_changes
from armdyn.arm.motion import motion_channels, torque_channels, without_idle_torques
from armdyn.arm.prediction import (
    JointTorquePredictor,
    joint_torque_predictor,
    predict_at_states,
    prepared_without_outliers,
)
from armdyn.arm.prepared import PreparedRun, torque_noise
from armdyn.arm.readings import with_servo_torques
from armdyn.arm.wrench.prediction import SensorWithEffects
from armdyn.arm.wrench.reading import WrenchReading, wrench_reading
from armdyn.arm.wrench.sensor import WrenchSensor, read_wrench_sensors
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.model import AssumedGain, Model, Prediction, prediction_from_channels
from armdyn.parameter import Parameter, Quantity
from armdyn.recording.gaps import cut_at_gaps
from armdyn.run import Channel, Run
from urdf import Robot


@dataclass(frozen=True, repr=False)
class ArmModel(Model):
    """Model of an arm: the rigid bodies of a URDF or MJCF, with effects.

    A parameter of an effect is called ``"<effect>.<quantity>[<joint>]"``, or ``"<effect>.<quantity>"`` where the effect
    acts on the base, whose joint is ``""``.

    Attributes:
        arm: the joints and their links.
        drives: drives by the name of their kind, for joints that record commands instead of torques.
        sensors: force/torque sensors by their name.
    """

    arm: Arm
    drives: Mapping[str, Servo] = field(default_factory=lambda: MappingProxyType({}))
    sensors: Mapping[str, WrenchSensor] = field(default_factory=lambda: MappingProxyType({}))

    base = "arm"
    linear = True
    values_are_cheap = True

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages on which effects may act."""
        return ("joint", *(("drive",) if self.drives else ()), *(("wrench",) if self.sensors else ()))

    @property
    def base_summary(self) -> str:
        """Text with the name of the arm, the number of its joints, and the first and last joint."""
        return f"arm {self.arm.robot.name}, {len(self.joints)} joints from {self.joints[0]} to {self.joints[-1]}"

    def file_entries(self, folder: Path) -> Mapping[str, Any]:
        """Entries of a model file that describe the arm and its drives."""
        drives = {name: servo.entries(self.arm.sliding[servo.joints[0]]) for name, servo in self.drives.items()}
        sensors = {name: sensor.entries() for name, sensor in self.sensors.items()}
        tables = {name: table for name, table in (("drives", drives), ("wrench", sensors)) if table}
        own = {**super().file_entries(folder), **self.arm.entries, **tables}
        if self.arm.file is None:
            return own
        try:
            place = Path(os.path.relpath(self.arm.file, folder.resolve())).as_posix()
        except ValueError:  # on another disk of Windows
            place = str(self.arm.file)
        return {**own, "urdf": place}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints from base to tool; other joints of the URDF are at zero, or move as recorded."""
        return self.arm.driven

    @property
    def robot(self) -> Robot:
        """Robot whose joints the model describes."""
        return self.arm.robot

    def adapted_to(self, runs: Sequence[Run]) -> Self:
        """The model with other joints that move in the runs, and with drives identified from them."""
        arm = with_joints_moving_as_recorded(self.arm, runs)
        drives = drives_with_identified_gains(self.drives, arm, runs)
        if arm is self.arm and drives == self.drives:
            return self
        return replace(self, arm=arm, drives=MappingProxyType(drives))

    def with_estimated_channels(self, run: Run) -> Run:
        """The run with torques of servo drives, estimated from their position or velocity errors."""
        return with_servo_torques(run, self.arm.joints, tuple(self.drives.values()))

    @property
    def open_questions(self) -> tuple[str, ...]:
        """Sentences on gains of drives that are not identifiable, with what would identify them."""
        return tuple(
            f"[drives.{name}]: the recordings do not say how large its gain is, {servo.gain.value:.3g} ± "
            f"{servo.gain.std:.2g} {servo.gain.unit}: values of {', '.join(servo.joints)} are ratios to k_p, right per "
            f"{servo.gain.unit} alone. To tell it, {recordings_that_identify_gains(self.arm, servo.joints)}"
            for name, servo in self.drives.items()
            if servo.gain is not None and not servo.determined
        )

    def assumed_gains(self, freed: Collection[str]) -> Sequence[AssumedGain]:
        """The gains that all axes of a force/torque sensor share, and its torques; see `Model.assumed_gains`.

        A sensor whose calibration is not stated counts as exact until its axes are found to be wrong.
        """
        gains, found = self.parameter_names_by_joint(SENSOR_GAIN_EFFECT), []
        for name, sensor in self.sensors.items():
            std, kept = self._gain_std(name, freed), (SENSOR_GAIN_EFFECT, *SENSOR_OFFSET_EFFECTS)
            relative = [p.name for p in self.parameters.values() if p.joint == name and p.effect in kept]
            question = (
                f"[wrench.{name}]: a wrench alone does not tell a gain that all its axes share from the tool's mass: "
                f"it is assumed to be 1 ± {std:.2g}, and standard deviations contain that. To tell it, record joint "
                "torques as well, or weigh the tool; gain_std states a better calibration"
            )
            asked = any(own in freed for own in gains.get(name, ()))
            found.append(AssumedGain(sensor.channels, std, tuple(relative), question if asked else ""))
            found.append(AssumedGain(sensor.channels[len("xyz") :], std, tuple(relative)))
        return [gain for gain in found if gain.std > 0.0]

    def _gain_std(self, sensor: str, freed: Collection[str]) -> float:
        stated, own = self.sensors[sensor].gain_std, self.parameter_names_by_joint(SENSOR_GAIN_EFFECT)
        priors = [self.parameters[name].prior for name in own.get(sensor, ()) if name in freed]
        return stated if stated is not None else max((p.std for p in priors if p), default=0.0)

    @property
    def excluded_effects(self) -> frozenset[str]:
        """Names of effects that are stated or identified for all drives of a kind, so that they are not candidates."""
        drives = self.drives.values()
        identified = {
            "servo_gain": any(servo.gain is None or servo.gain.std is not None for servo in drives),
            "command_delay": any(servo.delay is None for servo in drives),
            "supply_voltage": any(servo.supply is not None for servo in drives),
            "servo_damping": not any(servo.control.holds_position for servo in drives),
        }
        return EFFECTS_IDENTIFIED_PER_DRIVE_KIND | {name for name, told in identified.items() if told}

    def can_show(self, effect: Effect, channels: Collection[str]) -> bool:
        """Whether an effect is visible in recorded channels; see `Model.can_show`.

        A wrench shows loads, links and gravity, but nothing in a joint, which needs a torque.
        """
        if self.sensors and effect.in_joint and not any(name.startswith("tau.") for name in channels):
            return torque_functions_with_effects([effect]).link is not None and effect.is_visible_in(channels)
        return effect.is_visible_in(channels)

    def servo(self, joint: str) -> Servo | None:
        """The declared servo drive of a joint; None without one."""
        return next((servo for servo in self.drives.values() if joint in servo.joints), None)

    @property
    def servo_joints(self) -> frozenset[str]:
        """Names of the joints with declared servo drives."""
        return frozenset(joint for servo in self.drives.values() for joint in servo.joints)

    def with_drives(self, table: Mapping[str, Any]) -> Self:
        """The model with the servo drives of a table ``[drives]``; see `read_drives`."""
        return replace(self, drives=MappingProxyType(read_drives(table, self.arm.sliding))) if table else self

    def with_sensors(self, table: Mapping[str, Any]) -> Self:
        """The model with the force/torque sensors of a table ``[wrench]``; see `read_wrench_sensors`."""
        return replace(self, sensors=MappingProxyType(read_wrench_sensors(table, self.arm))) if table else self

    def joints_effect_can_act_on(self, effect: Effect) -> tuple[str, ...]:
        """Names of the joints, or of the force/torque sensors, on which an effect can act; ``("",)`` for the base.

        Raises:
            InputError: the effect cannot act on a joint that it names.
            UnknownNameError: the effect names a joint that the arm lacks.
        """
        if effect.acts_on == "wrench":
            for name in effect.joints:
                if name not in self.sensors:
                    raise UnknownNameError("force/torque sensor of the arm", name, self.sensors)
            return tuple(self.sensors)
        reachable = self.arm.reachable_joints(effect.reach)
        if effect.name in EFFECTS_STATED_BY_DRIVE or effect.acts_on == "drive":
            reachable = tuple(j for j in reachable if (j in self.servo_joints) == (effect.acts_on == "drive"))
        for joint in effect.joints:
            if joint not in self.joints:
                raise UnknownNameError("joint of the arm", joint, self.joints)
            if joint not in reachable:
                raise InputError(
                    f"the effect '{effect.name}' cannot act on joint '{joint}': {REASONS_AGAINST_EFFECT[effect.reach]}"
                )
        return reachable

    def with_effect(self, effect: Effect) -> Self:
        """The model with one more effect, at its null values.

        Raises:
            InputError: this arm has no joint on which the effect can act, or not the joint that it names.
        """
        if effect.acts_on in self.stages and not self.joints_effect_can_act_on(effect):
            raise InputError(
                f"the effect '{effect.name}' cannot act on this arm: {REASONS_AGAINST_EFFECT[effect.reach]}"
            )
        return super().with_effect(effect)

    def effect_parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """A parameter of an effect in the units and the typical size of its joint."""
        if joint in self.sensors:
            return quantity.parameter(effect, short, joint)
        return self.arm.parameter(quantity, effect, short, joint)

    def changes_link(self, names: Sequence[str]) -> bool:
        """Whether parameters `names` of one effect change a link, as those of a payload do."""
        joint = self.parameters[names[0]].joint
        if joint not in self.arm.joints:
            return False
        i = self.arm.joints.index(joint)
        link, own = self._functions[i].link, [self._columns[i].index(self.names.index(name)) for name in names]
        return link is not None and bool(link.depends[own].any())

    def split_at_gaps(self, run: Run) -> tuple[Run, ...]:
        """The parts of a run between missing samples: accelerations are differences of neighbouring samples.

        Constant torques of joints at rest are left out.
        """
        return tuple(without_idle_torques(part, self.arm.joints) for part in cut_at_gaps(run))

    def link_inertia_changes(
        self, theta: np.ndarray, covariance: np.ndarray, of_runs_alone: np.ndarray, free: np.ndarray
    ) -> tuple[LinkInertiaChange, ...]:
        """Links that effects change, in the order of the joints, with their values at (p,) fitted parameters."""
        found = link_inertia_changes(self.arm, self.changed_links(theta), covariance, of_runs_alone, free)
        return tuple(replace(link, loaded=f"payload.mass[{link.joint}]" in self.parameters) for link in found)

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which a residual may depend: position, velocity and acceleration of every joint."""
        del theta
        return motion_channels(run, self.arm.sliding)

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """Joint of each torque channel of a run, by the channel's name."""
        torques = (channel for channel in self.predicted_channels(run) if channel.startswith("tau."))
        return {channel: channel.removeprefix("tau.") for channel in torques}

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Names of the channels of a run that the model predicts: joint torques, then axes of force/torque sensors."""
        wrenches = [name for sensor in self.sensors.values() for name in sensor.recorded(run)]
        return torque_channels(run, self.arm.sliding, self.arm.carried, wrenches)

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run with low-passed and thinned torques; a prepared run is returned unchanged."""
        if isinstance(run, PreparedRun):
            return run
        self.predicted_channels(run)
        others = tuple(one.recording for one in beside)
        return prepared_without_outliers(run, self.arm, others, tuple(self.sensors.values()))

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """Standard deviation of the compared torques, by channel, with the inertias at (p,) parameters `theta`."""
        if not isinstance(run, PreparedRun):
            return {}
        arm, joints = self.arm.model, self.arm.joints
        torques = {name: joints.index(joint) for name, joint in self.force_channels(run).items()}
        found = torque_noise(run, self.rigid_body_model_at(theta), arm, joints, torques)
        for sensor in self.sensors_at(theta):
            found |= sensor.noise(run)
        return found

    def rigid_body_model_at(self, theta: np.ndarray) -> pin.Model:
        """The rigid bodies with the changes of links and rotors at (p,) `theta`."""
        rigid, armature = self.arm.model.copy(), np.zeros(len(self.arm.joints))
        for i, change in self._bodies(theta).links.items():
            rigid.inertias[i + 1] = pin.Inertia.FromDynamicParameters(self.arm.described[i] + change)
        for joint, (name,) in self.parameter_names_by_joint(ROTOR_EFFECT).items():
            armature[self.arm.joints.index(joint)] = theta[self.names.index(name)]
        rigid.armature = armature
        return rigid

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the measured torques of a run at (p,) parameters in the order of `names`."""
        parts, moving, given = [], {}, self._arguments(theta)
        found: dict[str, tuple[np.ndarray, Mapping[Any, np.ndarray]]] = {
            name: predictor.predict(*given) for name, predictor in self._predictors(run).items()
        }
        for sensor in self.sensors_at(theta):
            found |= {name: sensor.predict(run, name) for name in sensor.channels(run)}
        for name, (values, derivatives) in found.items():
            parts.append((name, run.channels[name].time, values, self._by_theta(derivatives, len(values))))
            moving[name] = np.array([i for joint in derivatives for i in self._columns_of(joint)], dtype=int)
        return replace(prediction_from_channels(parts), moving=moving)

    def predict_values(self, run: Run, theta: np.ndarray) -> Mapping[str, np.ndarray]:
        """(n,) predicted torques by channel; see `predict`."""
        given = self._arguments(theta)
        found = {name: predictor.values(*given) for name, predictor in self._predictors(run).items()}
        for sensor in self.sensors_at(theta):
            found |= {name: sensor.values(run, name) for name in sensor.channels(run)}
        return found

    def sensors_at(self, theta: np.ndarray) -> list[SensorWithEffects]:
        """The force/torque sensors at (p,) parameters."""
        if not self.sensors:
            return []
        given = self._arguments(theta)
        return [
            SensorWithEffects(self.arm, sensor, self._readings[name], theta[self._columns_of(name)], *given)
            for name, sensor in self.sensors.items()
        ]

    def _predictors(self, run: Run) -> dict[str, JointTorquePredictor]:
        channels = self.force_channels(run)
        return {name: joint_torque_predictor(run, self.arm, name) for name in channels}

    def _arguments(
        self, theta: np.ndarray
    ) -> tuple[Sequence[JointTorqueFunctions], Sequence[np.ndarray], RigidBodyChanges]:
        """Functions of all joints, (k,) parameters of each joint, and the changes of the rigid bodies."""
        return self._functions, [theta[columns] for columns in self._columns], self._bodies(theta)

    def at_states(self, stretch: MotionSamples) -> tuple[np.ndarray, np.ndarray]:
        """(n, nj) torques at n separate states, rather than along a motion, and their (n, nj, p) derivatives.

        Raises:
            InputError: an effect makes a torque depend on the past.
        """
        found = predict_at_states(stretch, *self._arguments(self.theta()))
        derivatives = [self._by_theta(by_joint, len(stretch.time)) for _, by_joint in found]
        return np.column_stack([torques for torques, _ in found]), np.stack(derivatives, axis=1)

    def wrenches_at_states(self, stretch: MotionSamples) -> np.ndarray:
        """(n, m, p) derivatives of the readings of m axes of force/torque sensors at n separate states.

        Raises:
            InputError: a sensor is late.
        """
        found = [axis for sensor in self.sensors_at(self.theta()) for axis in sensor.at_states(stretch)]
        count = len(stretch.time)
        derivatives = [self._by_theta(by_joint, count) for _, by_joint in found]
        return np.stack(derivatives, axis=1) if found else np.zeros((count, 0, len(self.names)))

    def _by_theta(self, derivatives: Mapping[Any, np.ndarray], count: int) -> np.ndarray:
        """(count, p) derivatives, from those by the parameters of each joint, of the base and of each sensor."""
        # Column by column: parameters on which nothing depends take no time.
        found = np.zeros((count, len(self.names)), order="F")
        for joint, columns in derivatives.items():
            found[:, self._columns_of(joint)] = columns
        return found

    def _columns_of(self, joint: int | str) -> list[int]:
        """Indices of the parameters of a joint, of the base, or of a sensor by its name, in the model's vector."""
        if isinstance(joint, str):
            return [self.names.index(f"{name}[{joint}]") for name in self._readings[joint].names]
        return self._base_columns if joint == BASE_INDEX else self._columns[joint]

    def changed_links(self, theta: np.ndarray) -> Mapping[int, tuple[np.ndarray, np.ndarray]]:
        """(10,) change and (10, p) derivatives of each link with effects, by its joint's index, at (p,) `theta`."""
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
        """(10,) inertial parameters of each joint's link, with effects, by the joint's name."""
        changes, described = self._bodies(self.theta()).links, self.arm.described
        return {
            joint: described[i] + changes.get(i, np.zeros(len(described[i]))) for i, joint in enumerate(self.arm.joints)
        }

    def gravity(self) -> np.ndarray:
        """(3,) acceleration of free fall in the frame of the base, m/s^2, with effects."""
        return self.gravity_at(self.theta())

    def gravity_at(self, theta: np.ndarray) -> np.ndarray:
        """(3,) acceleration of free fall in the frame of the base, m/s^2, at (p,) `theta`."""
        described, change = np.array(self.arm.model.gravity.linear), self._bodies(theta).gravity
        return described if change is None else described + change

    def _bodies(self, theta: np.ndarray) -> RigidBodyChanges:
        base = None
        if self._base is not None:
            base = self._base, np.array(self.arm.model.gravity.linear), theta[self._base_columns]
        return RigidBodyChanges.at(
            self._functions, [theta[columns] for columns in self._columns], self.arm.pseudo_inertia_factors, base
        )

    @cached_property
    def _base(self) -> InertialOrGravityChange | None:
        effects = [e for e in self.effects if e.reach == "base"]
        return gravity_change_by_effects(effects) if effects else None

    @cached_property
    def _base_columns(self) -> list[int]:
        """Indices of the parameters of effects on the base in the model's vector."""
        return [] if self._base is None else [self.names.index(name) for name in self._base.names]

    @cached_property
    def _functions(self) -> tuple[JointTorqueFunctions, ...]:
        return tuple(
            torque_functions_with_effects([e for e in self.effects if joint in self.joints_having_effect(e.name)])
            for joint in self.arm.joints
        )

    @cached_property
    def _readings(self) -> Mapping[str, WrenchReading]:
        """What each force/torque sensor reads with its effects, by its name."""
        having = {e: self.joints_having_effect(e.name) for e in self.effects if e.acts_on == "wrench"}
        return {
            name: wrench_reading([e for e, on in having.items() if name in on], sensor.axes)
            for name, sensor in self.sensors.items()
        }

    @cached_property
    def _columns(self) -> tuple[list[int], ...]:
        """Indices of each joint's parameters in the model's vector."""
        index = {name: i for i, name in enumerate(self.names)}
        return tuple(
            [index[f"{name}[{joint}]"] for name in functions.names]
            for joint, functions in zip(self.arm.joints, self._functions, strict=True)
        )


EFFECTS_STATED_BY_DRIVE = frozenset({"torque_gain", "torque_delay"})
"""Effects of joints without a declared drive: the table of a drive has the gain and the delay."""
EFFECTS_IDENTIFIED_PER_DRIVE_KIND = frozenset({"torque_limit"})
"""Effects that are identified for all drives of a kind: their saturation; see `drive_scale`."""
SENSOR_GAIN_EFFECT = "wrench_gain"
"""The effect of which only ratios between axes are seen where a tool's mass is unknown."""
SENSOR_OFFSET_EFFECTS = ("wrench_offset", "wrench_drift")
"""Effects that a sensor reads without a force, so that its gain does not scale them."""
ROTOR_EFFECT = "rotor_inertia"
"""The effect that adds inertia to a joint itself."""


def required_arm(model: Model, purpose: str, remedy: str) -> ArmModel:
    """The model as an arm's model; `purpose` and `remedy` begin and end the error message for another model.

    Raises:
        InputError: the model has another base.
    """
    arm = model.capability(ArmModel)
    if arm is None:
        raise InputError(f"{purpose} for arms, and this model's base is '{model.base}': {remedy}")
    return arm


def arm_model(
    urdf: str | Path | None = None,
    robot: str | None = None,
    joints: Sequence[str] | str | None = None,
    effects: Iterable[Effect] = (),
    *,
    tool: str | None = None,
) -> ArmModel:
    """Build an arm with effects at their null values.

    Args:
        urdf: path of its URDF; None for a known robot.
        robot: name of a known robot; None for a URDF.
        joints: names from base to tool, or one text with commas between them; by default the longest chain of the
            URDF, or the known robot's arm. Other joints are locked at zero.
        effects: effects of the model.
        tool: link that carries the tool.

    Raises:
        InputError: the description cannot be used, or lacks a joint.
    """
    joints = [name.strip() for name in joints.split(",")] if isinstance(joints, str) else joints
    model = ArmModel(
        effects=(), parameters=MappingProxyType[str, Parameter]({}), arm=load_arm_description(urdf, robot, joints, tool)
    )
    for item in effects:
        model = model.with_effect(item)
    return model
