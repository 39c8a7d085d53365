"""Baxter in MuJoCo: the default robot, and a source of recordings with known hidden physics."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np

import urdf
from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.gate import Gate
from pipeline.robot.devices import JointReadings, Reference, Servo, SimulatedCell
from pipeline.robot.forces import JointEffects, LoadForces, LoadString
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.robot.scene import TIME_STEP, LineFrame, build_scene
from pipeline.robot.settings import PlantSettings, checked_start
from pipeline.robot.start import place_at_rest
from pipeline.robot.truth import (
    GripperTruth,
    History,
    LoadTruth,
    MotionLog,
    PlantTruth,
    draw,
    gripper_truth,
    load_truth,
    swing_angle,
)

IN_BOX_FOR = 0.2
"""How long the load must have been in the box without a break to count as landed [s]."""

HISTORY_EVERY = 10
"""Steps between two entries of the history."""

DIVERGED = 1e8
"""Sum of squared velocities [rad^2/s^2, m^2/s^2] that no arm and no load on a string reaches."""


class SimulatedRobot:
    """A robot arm with a load on a string, as `protocol.Robot` sees it; it starts hanging at rest at time 0.

    The arm follows the commands with a lag, because its servo is soft, its joints rub and its links are heavier or
    lighter than the URDF says. The same seed and the same calls give the same motion and readings to the last bit.

    Args:
        robot: the arm; its line says where the box stands and which way is along.
        q_start: joint positions at time 0 (n,) [rad].
        settings: load, string, servo, sensors, box.
        hidden: hidden effects by name (`hidden.HIDDEN_EFFECTS`); None stands for the typical value.
        seed: of everything that is drawn.

    Raises:
        InputError: a posture outside the joint limits, or settings that do not fit the robot.
        UnknownNameError: a hidden effect that the plant does not have.
    """

    def __init__(
        self,
        robot: urdf.Robot,
        q_start: Vector,
        settings: PlantSettings | None = None,
        hidden: Mapping[str, float | None] | None = None,
        seed: int = 0,
    ) -> None:
        settings = settings or PlantSettings()
        self._robot, self._settings, self._hidden = robot, settings, resolve_hidden(hidden or {})
        q = checked_start(robot, q_start, settings)
        self._gate = Gate(robot.joint_names, robot.limits)
        plant_rng, cell_rng, reading_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
        drawn = draw(settings, len(q), plant_rng)
        mass = drawn.mass

        self._line = LineFrame.of(robot)
        self._model = build_scene(robot, settings, self._hidden, mass, drawn.link_scale)
        self._data, self._observed = mujoco.MjData(self._model), mujoco.MjData(self._model)
        self._dofs = np.array([self._model.joint(name).dofadr[0] for name in robot.joint_names])
        self._pivot = self._data.site_xpos[self._model.site("pivot").id]
        self._load = self._data.xpos[self._model.body("load").id]

        self._string = LoadString(self._model, mass)
        self._load_forces = LoadForces(
            self._model, self._data, self._string, self._hidden, self._line.along, mass, settings.length
        )
        self._joint_effects = JointEffects(self._model, self._data, robot, self._hidden, self._dofs)
        self._data.qpos[self._dofs] = q
        self._joint_effects.apply()
        pull = mass * self._model.opt.gravity + self._hidden["wind"] * self._line.along
        start = place_at_rest(
            self._model,
            self._data,
            self._string,
            self._dofs,
            q,
            settings,
            self._line.along,
            pull,
            self._hidden["out_of_plane_swing"],
        )
        servo = settings.servo
        self._reference = Reference(q, robot.limits, servo.hold_after, extrapolate=servo.extrapolate)
        self._servo = Servo(
            robot.model,
            settings.servo,
            self._reference,
            start.torque,
            np.asarray(robot.limits.effort),
            self._hidden["gripper_lag"],
            TIME_STEP,
        )
        self._cell = SimulatedCell(settings.cell, self._hidden, drawn.bias, drawn.latency, cell_rng, TIME_STEP)
        self._readings = JointReadings(settings.readings, self._hidden, reading_rng)
        self._reading: JointState | None = None
        self._truth = PlantTruth(
            **vars(drawn),
            length=settings.length,
            string_length=start.string_length,
            hidden={name: value for name, value in self._hidden.items() if value},
        )
        self._steps, self._steps_in_box, self._tension, self._observed_at = 0, 0, 0.0, -1
        self._until, self._log = 0.0, MotionLog()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the commanded joints."""
        return self._robot.joint_names

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * TIME_STEP

    @property
    def truth(self) -> PlantTruth:
        """What was drawn and what is hidden; for reports and verification only."""
        return self._truth

    def command(self, q: Vector, v: Vector, a: Vector) -> None:
        """Follow this reference from now on; it is extrapolated until the next one comes.

        Args:
            q: positions (n,) [rad].
            v: velocities (n,) [rad/s].
            a: accelerations (n,) [rad/s^2].

        Raises:
            InputError: a wrong length, a value that is not finite, beyond a limit of the joints or far from where the
                arm is; the arm goes on as before, and brakes when no good command follows.
        """
        q, v, a = (np.asarray(x, dtype=float) for x in (q, v, a))
        refusal = self._gate.check(q, v, a, self._data.qpos[self._dofs])
        if refusal is not None:
            raise InputError(refusal.sentence)
        self._reference.command(self.time, q, v, a)

    def stop(self) -> None:
        """Brake within the acceleration limits and hold, until the next command."""
        self._reference.stop(self.time)

    def advance(self, duration: float) -> None:
        """Compute what happens in the next `duration` seconds, in steps of 1 ms.

        Raises:
            InputError: a negative duration, or one that is not finite.
            TaskFailedError: the simulation has diverged.
        """
        if not 0.0 <= duration < math.inf:
            raise InputError(f"advance: a duration of {duration} s is not possible; give a finite one from 0")
        # Parts of a step are carried over, so that many short calls take as long as one.
        self._until += duration
        while self.time < self._until - TIME_STEP / 2:
            self._step()

    def joint_state(self) -> JointState:
        """Joint positions, velocities and motor torques as measured now; asked twice, the same reading."""
        if self._reading is None or self._reading.time != self.time:
            q, v = self._data.qpos[self._dofs], self._data.qvel[self._dofs]
            a = self._data.qacc[self._dofs]
            self._reading = self._readings.read(self.time, q, v, a, self._servo.torque(q, v))
        return self._reading

    def load_cell(self) -> list[ForceSample]:
        """Samples that arrived since the last call, stamped at reception [s, N]."""
        return self._cell.received(self.time)

    def load_in_box(self) -> bool:
        """Whether the load has been between the walls and below the rim for the last 0.2 s."""
        return self._steps_in_box * TIME_STEP >= IN_BOX_FOR

    def gripper_truth(self) -> GripperTruth:
        """True motion of the string's upper end, for reports and verification only."""
        self._observe()
        return gripper_truth(self._model, self._observed, self._line, self.time)

    def load_truth(self) -> LoadTruth:
        """True motion of the load and pull of the string, for reports and verification only."""
        self._observe()
        tension = self._string.tension(self._observed)
        return load_truth(self._model, self._observed, self._line, self.time, tension)

    def history(self) -> History:
        """True motion since time 0 every 10 ms, for reports and pictures only."""
        return self._log.history(len(self._dofs))

    def _step(self) -> None:
        model, data = self._model, self._data
        creep = self._hidden["string_creep"]
        if creep:
            self._string.length = self._truth.string_length + creep * self.time
        mujoco.mj_step1(model, data)
        data.ctrl[:] = self._servo.drive(self.time)
        self._load_forces.apply()
        self._joint_effects.apply()
        q = data.qpos[self._dofs]
        mujoco.mj_step2(model, data)
        # This bound is far below MuJoCo's own of 1e10, at which MuJoCo would write a log file into the user's folder.
        if not data.qvel @ data.qvel < DIVERGED:
            raise TaskFailedError(
                f"the simulation diverged at {self.time:.3f} s: a hidden effect or a gain is too large for 1 ms steps"
            )
        # Positions and tension still belong to the beginning of the step.
        self._tension = self._string.tension(data)
        angle = swing_angle(self._load - self._pivot, self._line.along) if self._cell.feels_direction else 0.0
        self._cell.feel(self._steps, self._tension, angle)
        self._steps_in_box = self._steps_in_box + 1 if self._load_is_inside() else 0
        if self._steps % HISTORY_EVERY == 0:
            self._log.add(self.time, q, self._pivot.copy(), self._load.copy(), self._tension)
        self._steps += 1

    def _observe(self) -> None:
        """Evaluate MuJoCo at the present state in a copy, so that looking at it changes nothing."""
        if self._observed_at == self._steps:
            return
        mujoco.mj_copyData(self._observed, self._model, self._data)
        self._observed.ctrl[:] = self._servo.driven
        mujoco.mj_forward(self._model, self._observed)
        self._observed_at = self._steps

    def _load_is_inside(self) -> bool:
        box = self._settings.box
        if box is None:
            return False
        above = float(self._load[2] - self._line.origin[2])
        if above > -box.rim:
            return False
        offset = self._load - self._line.origin
        return box.contains(float(offset @ self._line.along), float(offset @ self._line.across), above)
