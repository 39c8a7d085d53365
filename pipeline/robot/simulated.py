"""Simulated robot arm with a load on a string, in MuJoCo: for trials, and for recordings with known hidden effects."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np

import urdf
from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.gate import JointCommandCheck
from pipeline.robot.devices import CommandedMotion, SimulatedCell, SimulatedJointSensors, SimulatedServo
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.plant import (
    GripperShift,
    HeavyString,
    HiddenJointEffects,
    LoadForces,
    LoadString,
    Plant,
    place_at_rest,
)
from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.robot.scene import TIME_STEP
from pipeline.robot.settings import PlantSettings, checked_start_posture
from pipeline.robot.truth import TrueMotion, TruePlantParameters, swing_angle

MIN_LANDED_SECONDS = 0.2
"""Time for which the load must be in the box without a break to count as landed [s]."""
STEPS_PER_TRUE_MOTION_SAMPLE = 10
"""Number of simulation steps between two samples of the true motion."""
MAX_SUM_OF_SQUARED_SPEEDS = 1e8
"""Sum of squared velocities above which the simulation has diverged [rad^2/s^2, m^2/s^2]."""


class SimulatedRobot:
    """A simulated robot arm with a load on a string, with the methods of `RobotInterface`; at time 0 it is at rest.

    The arm follows commands with an error, because of a compliant controller, joint friction and inaccurate link
    masses in the URDF. The same seed and the same calls give exactly the same motion and readings.

    Args:
        robot: description of the arm; its line gives position and direction of the box.
        q_start: start posture (n,) [rad].
        settings: settings of the simulated robot; None for the default ones.
        hidden: size of each hidden effect by its name in `HIDDEN_EFFECTS`; None as a size is the typical one.
        seed: seed of all random values.

    Attributes:
        joint_names: names of the commanded joints.
        settings: settings of the simulated robot.
        truth: random and hidden true values, for reports and verification only.

    Raises:
        InputError: the start posture is outside the joint limits, or the settings do not fit the robot.
        UnknownNameError: there is no hidden effect of this name.
    """

    def __init__(
        self,
        robot: urdf.Robot,
        q_start: Vector,
        settings: PlantSettings | None = None,
        hidden: Mapping[str, float | None] | None = None,
        seed: int = 0,
    ) -> None:
        self.settings = settings = settings or PlantSettings()
        self._hidden = resolve_hidden(hidden or {})
        q = checked_start_posture(robot, q_start, settings)
        plant_rng, cell_rng, reading_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
        self.joint_names, self._gate = robot.joint_names, JointCommandCheck(robot.joint_names, robot.limits)
        plant = self._plant = Plant(robot, settings, self._hidden, plant_rng)
        self._data, self._string = plant.data, LoadString(plant)
        self._load_forces, self._joint_effects = LoadForces(plant, self._string), HiddenJointEffects(plant)
        self._data.qpos[plant.dofs] = q
        self._joint_effects.apply()
        self._shift, self._heavy = GripperShift(plant), HeavyString(plant)
        rest_torque = place_at_rest(plant, self._string, self._shift, q)
        servo, lead = settings.servo, self._hidden["gripper_lag"]
        self._reference = CommandedMotion(
            q, robot.limits, servo.hold_position_after_seconds, extrapolate=servo.extrapolate
        )
        self._servo = SimulatedServo(robot, servo, self._reference, rest_torque, lead)
        self._cell = SimulatedCell(settings.cell, self._hidden, plant.bias, plant.latency, cell_rng)
        self._readings = SimulatedJointSensors(settings.readings, self._hidden, reading_rng)
        self._reading: JointState | None = None
        present = {name: value for name, value in self._hidden.items() if value}
        self.truth = TruePlantParameters(
            plant.mass, plant.bias, plant.latency, plant.link_scale, settings.length, self._string.length, present
        )
        self._steps, self._steps_in_box, self._until = 0, 0, 0.0
        self._log: list[tuple[float, Vector, Vector, Vector, float]] = []

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * TIME_STEP

    def command(self, q: Vector, v: Vector, a: Vector) -> None:
        """Send a reference to follow (see `RobotInterface.command`), which is extrapolated until the next command.

        Raises:
            InputError: a wrong length, or a value that is not finite, beyond a joint limit or far from the arm's
                posture. The arm continues with the last valid command, and brakes without a new one.
        """
        q, v, a = (np.asarray(x, dtype=float) for x in (q, v, a))
        refusal = self._gate.check(q, v, a, self._data.qpos[self._plant.dofs])
        if refusal is not None:
            raise InputError(refusal.sentence)
        self._reference.command(self.time, q, v, a)

    def stop(self) -> None:
        """Brake within the acceleration limits and hold, until the next command."""
        self._reference.stop(self.time)

    def advance(self, duration: float) -> None:
        """Simulate the next `duration` seconds, in steps of 1 ms.

        Raises:
            InputError: the duration is negative or not finite.
            TaskFailedError: the simulation has diverged.
        """
        if not 0.0 <= duration < math.inf:
            raise InputError(f"advance: a duration of {duration} s is not possible; give a finite one from 0")
        # Fractions of a step are carried over, so that many short calls simulate the same time as one.
        self._until += duration
        while self.time < self._until - TIME_STEP / 2:
            self._step()

    def steady_load(self, seconds: float) -> None:
        """Let a hand steady the load for some seconds, while the arm holds its posture."""
        self._load_forces.hold(held=True)
        self.advance(seconds)
        self._load_forces.hold(held=False)

    def joint_state(self) -> JointState:
        """Measured joint positions, velocities and motor torques; calls at the same time return the same reading."""
        if self._reading is None or self._reading.time != self.time:
            dofs = self._plant.dofs
            q, v, a = self._data.qpos[dofs], self._data.qvel[dofs], self._data.qacc[dofs]
            self._reading = self._readings.measure(self.time, q, v, a, self._servo.torque(q, v))
        return self._reading

    def load_cell(self) -> list[ForceSample]:
        """Samples of the load cell that arrived since the last call, each with its time of reception."""
        return self._cell.new_samples(self.time)

    def load_in_box(self) -> bool:
        """Whether the load has been between the box's walls and below its rim for the last 0.2 s."""
        return self._steps_in_box * TIME_STEP >= MIN_LANDED_SECONDS

    def history(self) -> TrueMotion:
        """True motion since time 0, sampled every 10 ms, for reports and pictures only."""
        time, q, pivot, load, tension = zip(*self._log, strict=True) if self._log else ((), (), (), (), ())
        rows = np.reshape(q, (-1, len(self.joint_names)))
        return TrueMotion(
            np.array(time), rows, np.reshape(pivot, (-1, 3)), np.reshape(load, (-1, 3)), np.array(tension)
        )

    def _step(self) -> None:
        plant, data = self._plant, self._data
        creep = self._hidden["string_creep"]
        if creep:
            self._string.length = self.truth.string_length + creep * self.time
        self._shift.apply()
        mujoco.mj_step1(plant.model, data)
        data.ctrl[:] = self._servo.advance_filter(self.time)
        self._load_forces.apply()
        self._joint_effects.apply()
        q = data.qpos[plant.dofs]
        mujoco.mj_step2(plant.model, data)
        # This bound is far below MuJoCo's own of 1e10, at which MuJoCo would write a log file into the user's folder.
        if not data.qvel @ data.qvel < MAX_SUM_OF_SQUARED_SPEEDS:
            raise TaskFailedError(
                f"the simulation diverged at {self.time:.3f} s: a hidden effect or a gain is too large for 1 ms steps"
            )
        # Positions and tension still belong to the beginning of the step.
        tension = self._string.tension(data) + self._heavy.pull()
        angle = swing_angle(plant.load - plant.pivot, plant.line.direction) if self._cell.depends_on_direction else 0.0
        self._cell.apply_tension(self._steps, tension, angle)
        self._steps_in_box = self._steps_in_box + 1 if self._load_is_inside() else 0
        if self._steps % STEPS_PER_TRUE_MOTION_SAMPLE == 0:
            self._log.append((self.time, q, plant.pivot.copy(), plant.load.copy(), tension))
        self._steps += 1

    def _load_is_inside(self) -> bool:
        box, line = self.settings.box, self._plant.line
        if box is None or self._plant.load[2] - line.origin[2] > -box.rim:
            return False
        return box.contains(*map(float, (self._plant.load - line.origin) @ line.axes))
