r"""What motion along a path takes from the joints' torques.

The equation of motion \tau = M q'' + C q' + g + d q' (d the URDF's viscous damping), with q' = q_s v and
q'' = q_s a + q_ss v^2, is linear in the acceleration a of the path coordinate:

    \tau = push a + sling v^2 + drag v + hold,

    push = M q_s,   sling = M q_ss + C(q, q_s) q_s,   drag = d q_s,   hold = g.

(Bobrow, Dubowsky, Gibson 1985, The International Journal of Robotics Research 4(3).)
"""

from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf import Robot
from urdf.robot import read_only

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TorqueRows:
    """The four rows along a path and what springs add; every array is (k, n).

    Attributes:
        push: torque per acceleration [N m s^2/m].
        sling: torque per squared speed [N m s^2/m^2].
        drag: torque per speed [N m s/m].
        hold: torque against gravity at rest [N m].
        springs: what the robot's springs add to the motors' torque where they are counted in [N m].
    """

    push: Array
    sling: Array
    drag: Array
    hold: Array
    springs: Array

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, read_only(getattr(self, item.name)))

    @classmethod
    def of(cls, robot: Robot, q: Array, dq_ds: Array, d2q_ds2: Array) -> "TorqueRows":
        """The rows at postures of a path.

        Args:
            robot: the arm.
            q: postures, (k, n).
            dq_ds: their first derivatives by the path coordinate, (k, n).
            d2q_ds2: their second derivatives, (k, n).
        """
        model, data, still = robot.model, robot.model.createData(), np.zeros(robot.model.nv)
        hold = np.array([pin.rnea(model, data, at, still, still) for at in q])
        push = np.array([pin.rnea(model, data, at, still, rate) for at, rate in zip(q, dq_ds, strict=True)]) - hold
        both = zip(q, dq_ds, d2q_ds2, strict=True)
        sling = np.array([pin.rnea(model, data, at, rate, bending) for at, rate, bending in both]) - hold
        springs = np.zeros_like(hold)
        for spring in robot.springs:
            joint = robot.joint_names.index(spring.joint)
            springs[:, joint] += spring.torque(q[:, joint])
        return cls(push, sling, np.asarray(model.damping) * dq_ds, hold, springs)

    def at(self, s: Array, at: ArrayLike) -> "TorqueRows":
        """Rows between nodes, linear from node to node.

        Args:
            s: evenly spaced nodes, (k,) [m].
            at: path coordinates on them, a scalar or (m,).
        """
        place = (np.asarray(at, dtype=np.float64) - s[0]) / (s[-1] - s[0]) * (len(s) - 1)
        node = np.clip(place.astype(int), 0, len(s) - 2)
        share = (place - node)[..., None]
        return TorqueRows(
            *(
                (1 - share) * getattr(self, item.name)[node] + share * getattr(self, item.name)[node + 1]
                for item in fields(self)
            )
        )

    def torque(self, v: ArrayLike, a: ArrayLike, springs: bool = False) -> Array:
        """Torque of the motors, (k, n) [N m].

        Args:
            v: speed, a scalar or (k,) [m/s].
            a: acceleration, a scalar or (k,) [m/s^2].
            springs: whether the robot's springs help.
        """
        speed, acceleration = np.asarray(v, dtype=np.float64)[..., None], np.asarray(a, dtype=np.float64)[..., None]
        torque = self.push * acceleration + self.sling * speed**2 + self.drag * speed + self.hold
        return torque + self.springs if springs else torque

    def acceleration_range(self, effort: Array, v: ArrayLike, springs: bool = False) -> tuple[Array, Array]:
        """Lowest and highest acceleration [m/s^2] that the motors can give, (k,) each.

        Where the torques do not even suffice for a = 0, the range is what is nearest: it may exclude 0 or be empty
        (lowest > highest).

        Args:
            effort: torque limits, (n,) [N m].
            v: speed, a scalar or (k,) [m/s].
            springs: whether the robot's springs help.
        """
        taken = self.torque(v, 0.0, springs)
        push = np.where(np.abs(self.push) < 1e-12, 1e-12, self.push)
        ends = np.array([(effort - taken) / push, (-effort - taken) / push])
        return ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
