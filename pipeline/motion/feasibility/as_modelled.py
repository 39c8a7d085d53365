"""An arm as its model describes it: the torques of a motion with their bands, and the motion that its servos make.

The band of a joint's torque contains 95 % of the torques of a motion like those that the model was fitted to: half of
it is 1.96 sqrt(e^2 + sum_i (dtau/dtheta_i s_i)^2), with e the error in the runs of the last repair, held-out runs if
there were any, and s_i the standard deviations of the named effects' parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.closed_loop.rollout import (
    MAX_ROLLOUT_STEP_SECONDS,
    SimulationWindow,
    can_simulate_motion,
    drive_inputs,
    simulate_window,
)
from armdyn.arm.composition import composed_joint, depends_on_past
from armdyn.arm.control_laws import over_joints
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import Motion
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.model_file import ModelFile
from armdyn.run import Channel, Run
from pipeline.motion.trajectory import JointTrajectory
from urdf.robot import Array

BAND_STANDARD_DEVIATIONS = 1.96
"""Half the width of a torque's band in standard deviations: 95 % of a normal distribution."""
HOLDING_SECONDS = 1.0
"""Time for which the servos hold the first position before the motion, so that they carry the arm's weight [s]."""


@dataclass(frozen=True, eq=False)
class FollowedMotion:
    """The motion that an arm's servos make of a trajectory.

    Attributes:
        error: position minus trajectory at its stamps, (n, joints) [rad or m].
        time: times of the demanded torques, (m,) [s].
        demanded: torques that the control laws ask for, before their limits, (m, joints) [N m or N].
        limit: limits of the drives at these times, (m, joints) [N m or N].
    """

    error: Array
    time: Array
    demanded: Array
    limit: Array


@dataclass(frozen=True, eq=False)
class ModelledArm:
    """An arm with its effects.

    Attributes:
        model: the arm.
        error: root mean square error of each joint's predicted torque in recordings, (joints,) [N m or N].
    """

    model: ArmModel
    error: Array

    @classmethod
    def of_file(cls, file: ModelFile) -> Self:
        """The arm of a model file; its torques have the errors of the file's last change.

        Raises:
            InputError: the model is not an arm.
        """
        model = file.model.capability(ArmModel)
        if model is None:
            raise InputError(f"its base is '{file.model.base}': give the model of an arm")
        last: Mapping[str, Mapping[str, float]] = file.history[-1] if file.history else {}
        of_runs = last.get("held_out_rmse") or last.get("rmse") or {}
        return cls(model, np.array([float(of_runs.get(f"tau.{joint}", 0.0)) for joint in model.arm.joints]))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of effects on torques that depend on what was before, which the torque of an instant lacks."""
        return tuple(e.name for e in self.model.effects if _acts(e) and depends_on_past(e))

    @property
    def limit(self) -> Array:
        """Largest torque of each joint, (joints,): that of its description, or of its servo if it is smaller."""
        servos = (self.model.servo(joint) for joint in self.model.arm.joints)
        of_drives = np.array([np.inf if servo is None else servo.largest for servo in servos])
        return np.minimum(self.model.arm.model.effortLimit, of_drives)

    def torques(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Torques of a motion with every effect, and half the widths of their bands, (n, joints) [N m or N] each.

        Args:
            q: positions, (n, joints) [rad or m].
            v: velocities, (n, joints), whose signs are the directions of friction.
            a: accelerations, (n, joints).
        """
        kept = {e.name for e in self.model.effects if _acts(e)} - set(self.left_out)
        model, time = self.model.with_only_effects(kept), np.arange(float(len(q)))
        torque, slopes = model.at_states(MotionSamples(model.arm.model, Motion(time, q, v, a, np.sign(v)), 0.0 * time))
        small = () if model.background is None else model.background.names
        std = np.array([0.0 if n in small else p.std or 0.0 for n, p in model.parameters.items()])
        return torque, BAND_STANDARD_DEVIATIONS * np.sqrt(self.error**2 + ((slopes * std) ** 2).sum(axis=2))

    def followed(self, motion: JointTrajectory) -> FollowedMotion | None:
        """The motion that the servos make of a trajectory; None if not every joint has a servo that follows it."""
        model, joints = self.model, self.model.arm.joints
        sampled = (("q", motion.q, ""), ("q_cmd", motion.q, ""), ("v_cmd", motion.v, "/s"))
        run = Run(
            "trajectory",
            {
                f"{kind}.{joint}": Channel(motion.time, values[:, j], ("m" if slides else "rad") + per)
                for kind, values, per in sampled
                for j, (joint, slides) in enumerate(zip(joints, model.arm.slides, strict=True))
            },
        )
        if not can_simulate_motion(model, run):
            return None
        theta, servos = model.theta(), [model.servo(joint) for joint in joints]
        start = motion.q[0], np.zeros(len(joints))
        window = SimulationWindow(
            run, float(motion.time[0]) - HOLDING_SECONDS, float(motion.time[-1]), start, motion.time, motion.q
        )
        moved = simulate_window(model, theta, window, servos, MAX_ROLLOUT_STEP_SECONDS)
        inputs = drive_inputs(model, theta, run, servos, moved.edges)
        middle = [(part[1:] + part[:-1]) / 2.0 for part in (moved.edges, moved.q, moved.v)]
        demanded = np.column_stack(
            over_joints(lambda law: law.unlimited_torque, inputs.laws, inputs.signals, *middle[1:])
        )
        during = middle[0] >= motion.time[0]
        return FollowedMotion(
            moved.links_at(model, theta, motion.time) - motion.q,
            middle[0][during],
            demanded[during],
            inputs.signals.limit[during],
        )


def _acts(effect: Effect) -> bool:
    """Whether an effect changes a drive's torque, and not only what is read of it."""
    if not effect.in_joint:
        return effect.reach == "base"
    after = composed_joint((effect.on(),)).after
    changed = ca.vertcat(after.torque, after.inner_torque, ca.vec(after.link.pseudo_inertia))
    return bool(ca.depends_on(changed, composed_joint((effect.on(),)).theta))
