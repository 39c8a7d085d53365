"""Which channels a watch compares with the model: torques of the joints, and the axes of force/torque sensors."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.recording.channels import WRENCH_CHANNELS
from armdyn.run import Run


@dataclass(frozen=True, eq=False)
class WatchedChannels:
    """The nc channels of a watch: torques of all nj joints of an arm, then six axes of each force/torque sensor.

    Attributes:
        joints: names of the joints.
        sensors: names of the sensors.
        names: (nc,) names of the channels in a recording.
        units: (nc,) units.
        asked: (nc,) whether the channel is recorded; the others have no part in anything.
        kind: (nc,) the same number for channels that have comparable errors: torques of the joints, and of each sensor
            the forces and the torques.
        reaction: (nc,) reading per torque or force from outside: drives hold against it, a sensor feels it.
    """

    joints: tuple[str, ...]
    sensors: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    asked: np.ndarray
    kind: np.ndarray
    reaction: np.ndarray

    @classmethod
    def of(cls, model: ArmModel, runs: Sequence[Run] = (), *, sensed: Collection[str] | None = None) -> Self:
        """Those of an arm that runs contain: no sensor that one lacks, no joint's torque if one has a wrench alone.

        Args:
            model: the arm.
            runs: recordings that are to be watched.
            sensed: names of the sensors that may be watched; None for all.
        """
        joints = model.arm.joints
        sensors = [
            name
            for name, sensor in model.sensors.items()
            if (sensed is None or name in sensed)
            and all(channel in run.channels for run in runs for channel in sensor.channels)
        ]
        torques = not sensors or all(f"tau.{joint}" in run.channels for run in runs for joint in model.joints)
        axes = [channel for name in sensors for channel in model.sensors[name].channels]
        count, units = len(joints), ["N" if slides else "N m" for slides in model.arm.slides]
        forces = [WRENCH_CHANNELS[channel.partition(".")[0]].units[0] for channel in axes]
        return cls(
            joints,
            tuple(sensors),
            (*(f"tau.{joint}" for joint in joints), *axes),
            (*units, *forces),
            np.array([torques and joint in model.joints for joint in joints] + [True] * len(axes)),
            np.array([0] * count + [1 + i // 3 for i in range(len(axes))]),
            np.array([-1.0] * count + [1.0] * len(axes)),
        )

    def of_sensor(self, name: str) -> slice:
        """The six channels of a sensor."""
        begin = len(self.joints) + self.sensors.index(name) * len(WRENCH_CHANNELS)
        return slice(begin, begin + len(WRENCH_CHANNELS))

    @property
    def labels(self) -> tuple[str, ...]:
        """(nc,) name of each channel for people: that of its joint, or of the sensor's axis."""
        return self.joints + self.names[len(self.joints) :]

    def joint(self, channel: int) -> str | None:
        """Name of the joint that has a channel; None for a sensor's."""
        return self.joints[channel] if channel < len(self.joints) else None
