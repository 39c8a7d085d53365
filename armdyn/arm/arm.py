"""The arm: its joints, their kinds, and their links as the URDF describes them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

import urdf
from armdyn.arm.rigid import described_parameters, parents, shape
from armdyn.effects.effect import Reach
from armdyn.errors import InputError
from armdyn.parameter import Parameter, Quantity
from armdyn.recording.units import sliding_unit

USUAL_EFFORT = 50.0
"""N m; the effort limit of the joint for which an effect's typical sizes are written."""
BASE = ""
"""Where an effect on the base acts, in place of a joint's name."""
METRES_PER_RADIAN = 0.1
"""What counts as much for a joint that slides as a radian for one that turns."""
CANNOT: Mapping[Reach, str] = {
    "every": "the arm has no joint",
    "turning": "it acts on joints that turn",
    "coupled": "it acts on joints whose neighbour towards the base is of the same kind",
    "last": "it acts on the last joint of an arm",
    "base": "it acts on the base of the arm; leave out the joint",
}
"""Why an effect with this reach cannot act on an arm, or on a joint."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as described.

    Attributes:
        robot: from its URDF, reduced to the arm's joints.
        file: of the URDF or settings that it was read from; None where the robot is known by name.
        carried: joints among them that move as they were recorded, and of which nothing is asked: see `following`.
    """

    robot: urdf.Robot
    file: Path | None
    carried: frozenset[str] = frozenset()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names from base to tool."""
        return self.robot.joint_names

    @property
    def driven(self) -> tuple[str, ...]:
        """Names from base to tool of the joints whose torques are explained, and on which effects act."""
        return tuple(joint for joint in self.joints if joint not in self.carried)

    @cached_property
    def model(self) -> pin.Model:
        """Rigid bodies for Pinocchio; rotors, which an MJCF may describe, are effects here."""
        model = self.robot.model.copy()
        model.armature = np.zeros(model.nv)
        return model

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Per joint: whether it slides rather than turns."""
        return tuple("P" in joint.shortname().removeprefix("JointModel") for joint in list(self.model.joints)[1:])

    @cached_property
    def described(self) -> np.ndarray:
        """(nj, 10) inertial parameters of the moved links."""
        return described_parameters(self.model)

    @cached_property
    def shapes(self) -> np.ndarray:
        """(nj, 4, 4) triangular factor of each moved link's pseudo-inertia."""
        return np.array([shape(p, float(self.described[:, 0].max())) for p in self.described])

    @cached_property
    def without_inertia(self) -> tuple[str, ...]:
        """Links that the joints move and that weigh nothing, with all that is fixed to them.

        Not those between two joints of one place, as in a wrist, where nothing could weigh anything.
        """
        between = {
            parent for parent, place in zip(self.model.parents, self.model.jointPlacements, strict=True)
            if not np.any(place.translation)
        }  # fmt: skip
        weightless = {i + 1 for i, mass in enumerate(self.described[:, 0]) if not mass > 0.0} - between
        bodies = {f.parentJoint: f.name for f in reversed(list(self.model.frames)) if f.type == pin.FrameType.BODY}
        return tuple(bodies[joint] for joint in sorted(weightless))

    def within(self, reach: Reach) -> tuple[str, ...]:
        """Joints that an effect with this reach can act on, or `BASE`."""
        indices = [i for i, joint in enumerate(self.joints) if joint not in self.carried]
        inner = [parent if parent in indices else -1 for parent in parents(self.model)]
        chosen: Mapping[Reach, Iterable[int]] = {
            "every": indices,
            "turning": (i for i in indices if not self.slides[i]),
            "coupled": (i for i in indices if inner[i] >= 0 and self.slides[i] == self.slides[inner[i]]),
            "last": indices[-1:],
            "base": (),
        }
        return (BASE,) if reach == "base" else tuple(self.joints[i] for i in chosen[reach])

    def parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """A parameter of an effect on one joint, in the units of that joint and of the size that it has there.

        Args:
            quantity: as written for a joint that turns with an effort of 50 N m.
            effect: its name.
            short: name of the quantity.
            joint: which, or `BASE`.
        """
        if joint == BASE:
            return quantity.parameter(effect, short)
        i = self.joints.index(joint)
        effort = float(self.model.effortLimit[i])
        torque, angle = _powers(quantity.unit)
        strength = effort / USUAL_EFFORT if np.isfinite(effort) else 1.0
        length = METRES_PER_RADIAN if self.slides[i] else 1.0
        scale = strength**torque * length**angle
        adapted = replace(
            quantity,
            unit=sliding_unit(quantity.unit) if self.slides[i] else quantity.unit,
            typical=quantity.typical * scale,
            null=quantity.null * scale,
            lower=quantity.lower * scale,
            upper=quantity.upper * scale,
            spread=None if quantity.spread is None else quantity.spread * scale,
        )
        return adapted.parameter(effect, short, joint)


def find_arm(
    urdf_path: str | Path | None = None,
    robot: str | None = None,
    joints: Sequence[str] | None = None,
    tool: str | None = None,
) -> Arm:
    """The arm of a URDF or of a known robot; joints that are not named stay where their zero is.

    Raises:
        InputError: not exactly one of both is given, or the description cannot be used.
    """
    if (urdf_path is None) == (robot is None):
        raise InputError("an arm needs its URDF or a known robot's name: give one of urdf and robot")
    if urdf_path is not None and not Path(urdf_path).exists():
        raise InputError(f"{urdf_path}: no such URDF file")
    chosen = None if joints is None else tuple(joints)
    if chosen is not None and len(chosen) == 0:
        raise InputError("an arm needs at least one joint: name some, or leave them out to take all of the arm")
    try:
        found = urdf.load(str(robot or urdf_path), joints=chosen, tool=tool, meshes=False)
    except urdf.UrdfError as error:
        raise InputError(str(error)) from error
    return Arm(found, None if robot is not None else Path(str(urdf_path)).resolve())


def _powers(unit: str) -> tuple[int, int]:
    """How a unit scales with the size of torques and of angles: ``"N m s/rad"`` is torque^1 angle^-1."""
    if unit == "kg m^2":
        return 1, -1
    numerator, _, denominator = unit.partition("/")
    return int("N m" in numerator) - int("N m" in denominator), _radians(numerator) - _radians(denominator)


def _radians(text: str) -> int:
    return sum(int(power or 1) for power in re.findall(r"\brad(?:\^(\d+))?", text))
