"""Encoders and effort sensing of the simulated robot."""

from collections.abc import Mapping

import numpy as np

from pipeline.robot.protocol import JointState, Vector
from pipeline.robot.settings import ReadingSettings


class JointReadings:
    """Turns true joint positions, velocities and torques into what the robot reports.

    Args:
        settings: noise and resolution.
        hidden: value of every effect.
        rng: source of the noise.
    """

    def __init__(self, settings: ReadingSettings, hidden: Mapping[str, float], rng: np.random.Generator) -> None:
        self._settings, self._hidden, self._rng = settings, hidden, rng

    def read(self, time: float, q: Vector, v: Vector, a: Vector, tau: Vector) -> JointState:
        """One reading of the joints.

        Args:
            time: [s].
            q: true joint positions (n,) [rad].
            v: true velocities (n,) [rad/s].
            a: true accelerations (n,) [rad/s^2].
            tau: torques of the motors (n,) [N m].
        """
        settings, hidden = self._settings, self._hidden
        noise = self._rng.standard_normal((3, len(q)))
        # x' lag + x = reported: what the encoders see leads the arm.
        lag = hidden["gripper_lag"]
        position = q + lag * v + settings.position_noise * noise[0]
        if settings.resolution > 0:
            position = settings.resolution * np.round(position / settings.resolution)
        velocity = v + lag * a + settings.velocity_noise * noise[1]
        effort = (1.0 + hidden["torque_gain"]) * tau + hidden["torque_offset"]
        effort = effort + np.array(settings.effort_noise) * noise[2]
        return JointState(time, position, velocity, effort)
