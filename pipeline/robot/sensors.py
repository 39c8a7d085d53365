"""What the simulated robot measures: the load cell's samples, and the joints' positions, speeds and efforts."""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from pipeline.robot.protocol import ForceSample, JointState, Vector
from pipeline.robot.settings import CellFault, CellSettings, ReadingSettings


class SimulatedCell:
    """Samples the string tension at a fixed period and delivers the samples with a latency.

    Args:
        settings: noise, resolution, range, faults.
        hidden: value of every effect.
        bias: zero error [N].
        latency: time from the force to the reception of its sample, sensor_delay not counted [s].
        rng: source of the noise.
        step: time between two calls of `feel` [s].
    """

    def __init__(
        self,
        settings: CellSettings,
        hidden: Mapping[str, float],
        bias: float,
        latency: float,
        rng: np.random.Generator,
        step: float,
    ) -> None:
        self._settings, self._hidden, self._rng = settings, hidden, rng
        self._bias = bias + hidden["sensor_bias"]
        self._delay = latency + hidden["sensor_delay"]
        self._every = max(1, round(settings.period / step))
        self._step = step
        self._gain = 1.0 - math.exp(-step / hidden["sensor_lag"]) if hidden["sensor_lag"] > 0 else 1.0
        self._felt: float | None = None
        self._last = 0.0
        self._on_the_way: deque[ForceSample] = deque()

    @property
    def feels_direction(self) -> bool:
        """Whether the string's direction matters, not only its pull."""
        return bool(self._hidden["vertical_sensing_axis"] or self._hidden["cross_axis_sensitivity"])

    def feel(self, steps: int, tension: float, swing_angle: float) -> None:
        """Take in the string's pull at one step of the physics.

        Args:
            steps: number of steps since time 0.
            tension: string tension [N].
            swing_angle: angle of the string from the vertical, seen along the line's normal [rad].
        """
        vertical = self._hidden["vertical_sensing_axis"]
        along_axis = tension * (1.0 - vertical + vertical * math.cos(swing_angle))
        along_axis += self._hidden["cross_axis_sensitivity"] * tension * math.sin(swing_angle)
        self._felt = along_axis if self._felt is None else self._felt + self._gain * (along_axis - self._felt)
        if steps % self._every == 0:
            self._sample(steps * self._step, self._felt)

    def received(self, now: float) -> list[ForceSample]:
        """Samples that arrived up to `now` [s] and were not handed out yet."""
        arrived = []
        while self._on_the_way and self._on_the_way[0].time <= now + 1e-9:
            arrived.append(self._on_the_way.popleft())
        return arrived

    def _sample(self, time: float, force: float) -> None:
        hidden, settings = self._hidden, self._settings
        reading = (1.0 + hidden["sensor_gain"]) * force + hidden["sensor_nonlinearity"] * force**2
        reading += self._bias + hidden["sensor_drift"] * time
        # The noise is drawn in every case, so that a fault does not change the noise of later samples.
        reading += settings.noise * self._rng.standard_normal()
        if settings.resolution > 0:
            reading = settings.resolution * round(reading / settings.resolution)
        active = {f.fault for f in settings.faults if time >= f.time}
        if CellFault.UNPLUGGED in active:
            return
        if CellFault.FROZEN in active:
            reading = self._last
        elif CellFault.SATURATED in active:
            reading = settings.full_scale
        self._last = min(max(reading, -settings.full_scale), settings.full_scale)
        self._on_the_way.append(ForceSample(time + self._delay, self._last))


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
