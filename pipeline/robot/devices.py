"""Devices of the simulated robot: a joint controller like Baxter's, joint sensors and a load cell."""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

import urdf
from pipeline.motion.transitions import BrakingMotion
from pipeline.robot.hidden import HiddenEffectStage, hidden_effect_terms
from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.robot.scene import TIME_STEP
from pipeline.robot.settings import CellSettings, ServoSettings, SimulatedJointSensorSettings

ACCELERATION_EXTRAPOLATION_SECONDS = 0.02
"""Time for which a command's acceleration is extrapolated [s]: two command periods."""


class CommandedMotion:
    """Commanded motion of the joints as a function of time: between two commands, and braking after the last command.

    Args:
        q: posture of the arm at rest at the start (n,) [rad].
        limits: limits of the joints, for braking.
        hold_position_after_seconds: time after a command at which the arm brakes if no other command comes [s].
        extrapolate: whether the position continues along the commanded velocity until the next command.
    """

    def __init__(
        self, q: Vector, limits: urdf.Limits, hold_position_after_seconds: float, extrapolate: bool = True
    ) -> None:
        self._limits, self._hold_after, self._extrapolate = limits, hold_position_after_seconds, extrapolate
        self._start, self._brake_at = 0.0, math.inf
        self._q, self._v, self._a = q.copy(), np.zeros_like(q), np.zeros_like(q)
        self._brake: BrakingMotion | None = None

    def command(self, time: float, q: Vector, v: Vector, a: Vector) -> None:
        """Follow position, velocity and acceleration (n,) from `time` [s] on."""
        self._start, self._q, self._v, self._a = time, q.copy(), v.copy(), a.copy()
        self._brake_at, self._brake = time + self._hold_after, None

    def stop(self, time: float) -> None:
        """Brake from `time` [s] on."""
        if time < self._brake_at:
            self._brake_at, self._brake = time, None

    def at(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Commanded position, velocity and acceleration (n,) at `time` [s]."""
        if time < self._brake_at:
            return self._extrapolated(time)
        if self._brake is None:
            q, v, a = self._extrapolated(self._brake_at)
            self._brake = BrakingMotion((q, v, a) if self._extrapolate else (q, 0.0 * v, 0.0 * a), self._limits)
        return self._brake.state_at(time - self._brake_at)

    def _extrapolated(self, time: float) -> tuple[Vector, Vector, Vector]:
        age = time - self._start
        if not self._extrapolate:
            fresh = float(age <= ACCELERATION_EXTRAPOLATION_SECONDS)
            return self._q, fresh * self._v, fresh * self._a
        trusted = min(age, ACCELERATION_EXTRAPOLATION_SECONDS)
        v = self._v + self._a * trusted
        q = self._q + self._v * trusted + 0.5 * self._a * trusted**2 + v * (age - trusted)
        return q, v, self._a if age <= ACCELERATION_EXTRAPOLATION_SECONDS else np.zeros_like(v)


class SimulatedServo:
    """Simulated joint controller, with the motor torque ``Kp (q_f - q) + Kd (v_f - v) + f_f``.

    Quantities with the index f passed a first-order filter. The feed-forward f is Pinocchio's inverse dynamics of the
    nominal arm, which contains neither the joints' friction and rotors nor the true inertias nor the load. The torque
    that it lacks at the start is added as a constant, like the steady state of an integrator.

    Args:
        robot: the nominal arm; its effort limits are those of the motors.
        settings: gains and filter.
        reference: commanded motion.
        rest_torque: motor torque that holds the arm at the start (n,) [N m].
        encoder_lead: time by which the encoders lead the joints [s].
    """

    def __init__(
        self,
        robot: urdf.Robot,
        settings: ServoSettings,
        reference: CommandedMotion,
        rest_torque: Vector,
        encoder_lead: float,
    ) -> None:
        self._model, self._data, self._limit = robot.model, robot.model.createData(), robot.limits.effort
        self._kp, self._kd = np.array(settings.stiffness), np.array(settings.damping)
        self._lead, self._reference = encoder_lead, reference
        self._gain = _share_per_step(settings.command_filter_time_constant)
        q, v, a = reference.at(0.0)
        self._constant = rest_torque - pin.rnea(self._model, self._data, q, v, a)
        self.reference_torque = self._wanted(0.0)

    def advance_filter(self, time: float) -> Vector:
        """Advance the filter by one step, and return the reference's part of the torque, ``Kp q_f + Kd v_f + f_f``.

        Args:
            time: time of the simulation [s].

        Returns:
            Torques (n,) [N m].
        """
        self.reference_torque = self.reference_torque + self._gain * (self._wanted(time) - self.reference_torque)
        return self.reference_torque

    def torque(self, q: Vector, v: Vector) -> Vector:
        """Torque of the motors (n,) [N m] at joint positions and velocities (n,) [rad, rad/s]."""
        total = self.reference_torque - self._kp * (q + self._lead * v) - self._kd * v
        return np.clip(total, -self._limit, self._limit)

    def _wanted(self, time: float) -> Vector:
        q, v, a = self._reference.at(time)
        return np.asarray(self._kp * q + self._kd * v + pin.rnea(self._model, self._data, q, v, a) + self._constant)


def _share_per_step(time_constant: float) -> float:
    """Share of the distance to its input that a first-order filter covers in one step of the physics."""
    return 1.0 - math.exp(-TIME_STEP / time_constant) if time_constant > 0 else 1.0


class SimulatedCell:
    """Simulated load cell: measures the string's tension at a fixed period, and delivers the samples late.

    Args:
        settings: period, noise, resolution and range.
        hidden: sizes of the hidden effects, which change the readings.
        bias: zero error [N].
        latency: time from the force to the delivery of its sample [s], without the hidden delay.
        rng: source of the noise.
    """

    def __init__(
        self, settings: CellSettings, hidden: Mapping[str, float], bias: float, latency: float, rng: np.random.Generator
    ) -> None:
        self._settings, self._hidden, self._rng = settings, hidden, rng
        self._bias, self._terms = bias, hidden_effect_terms(hidden, HiddenEffectStage.FORCE)
        self._delay = latency + hidden["sensor_delay"]
        self._every = max(1, round(settings.period / TIME_STEP))
        self._gain = _share_per_step(hidden["sensor_lag"])
        self._filtered: float | None = None
        self._on_the_way: deque[ForceSample] = deque()

    @property
    def depends_on_direction(self) -> bool:
        """Whether the reading depends on the direction of the string as well as on its tension."""
        return bool(self._hidden["vertical_sensing_axis"] or self._hidden["cross_axis_sensitivity"])

    def apply_tension(self, steps: int, tension: float, swing_angle: float) -> None:
        """Apply the string's force to the cell for one step of the simulation.

        Args:
            steps: number of steps since time 0.
            tension: tension of the string [N].
            swing_angle: angle of the string from the vertical, in the plane of line and vertical [rad].
        """
        vertical = self._hidden["vertical_sensing_axis"]
        along_axis = tension * (1.0 - vertical + vertical * math.cos(swing_angle))
        along_axis += self._hidden["cross_axis_sensitivity"] * tension * math.sin(swing_angle)
        self._filtered = (
            along_axis if self._filtered is None else self._filtered + self._gain * (along_axis - self._filtered)
        )
        if steps % self._every == 0:
            self._sample(steps * TIME_STEP, self._filtered)

    def new_samples(self, now: float) -> list[ForceSample]:
        """Samples that arrived since the last call, up to the time `now` [s]."""
        arrived = []
        while self._on_the_way and self._on_the_way[0].time <= now + 1e-9:
            arrived.append(self._on_the_way.popleft())
        return arrived

    def _sample(self, time: float, force: float) -> None:
        settings = self._settings
        reading = force + self._bias + sum(term(force, time) for term in self._terms)
        reading += settings.noise * self._rng.standard_normal()
        if settings.resolution > 0:
            reading = settings.resolution * round(reading / settings.resolution)
        reading = min(max(reading, -settings.full_scale), settings.full_scale)
        self._on_the_way.append(ForceSample(time + self._delay, reading))


class SimulatedJointSensors:
    """Simulated encoders and effort sensors: add noise, resolution and hidden sensor errors to the true values."""

    def __init__(
        self, settings: SimulatedJointSensorSettings, hidden: Mapping[str, float], rng: np.random.Generator
    ) -> None:
        self._settings, self._lag, self._rng = settings, hidden["gripper_lag"], rng
        self._terms = hidden_effect_terms(hidden, HiddenEffectStage.EFFORT)

    def measure(self, time: float, q: Vector, v: Vector, a: Vector, tau: Vector) -> JointState:
        """One reading at a time [s], of true positions, velocities, accelerations and motors' torques, (n,) each."""
        settings, lag = self._settings, self._lag
        noise = self._rng.standard_normal((3, len(q)))
        # x' lag + x = reported: the encoder readings lead the arm.
        position = q + lag * v + settings.position_noise * noise[0]
        if settings.resolution > 0:
            position = settings.resolution * np.round(position / settings.resolution)
        velocity = v + lag * a + settings.velocity_noise * noise[1]
        effort = tau + sum(term(tau) for term in self._terms) + np.array(settings.effort_noise) * noise[2]
        return JointState(time, position, velocity, effort)
