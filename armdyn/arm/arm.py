"""An arm as its description states it: joints, their kinds, and links."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import urdf
from armdyn.arm.rigid import described_parameters, parent_joints, pseudo_inertia_factor
from armdyn.effects.effect import Reach
from armdyn.errors import InputError
from armdyn.parameter import Parameter, Quantity
from armdyn.recording.units import sliding_unit
from urdf.toml_tables import files_beside

REFERENCE_EFFORT_LIMIT_NM = 50.0
"""Effort limit, N m, of the joint for which typical sizes of effects are written."""
JOINT_NAME_OF_BASE = ""
"""Name that stands for the base where a joint's name is expected."""
EQUIVALENT_METRES_PER_RADIAN = 0.1
"""Displacement of a joint that slides, m, with the effect of a radian of one that turns."""
REASONS_AGAINST_EFFECT: Mapping[Reach, str] = {
    "every": "the arm has no joint",
    "turning": "it acts on joints that turn",
    "coupled": "it acts on joints whose neighbour towards the base is of the same kind",
    "last": "it acts on the last joint of an arm",
    "base": "it acts on the base of the arm; leave out the joint",
}
"""Reason why an effect cannot act on an arm or on a joint, by reach."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as its description (URDF or MJCF) states it.

    Attributes:
        robot: the robot of a URDF, reduced to the arm's joints.
        file: file of the URDF or of the settings; None for a known robot.
        carried: joints that move as recorded and have no effects and no predicted torques; see `ArmModel.adapted_to`.
        entries: entries of a model file that choose the arm besides the URDF: ``robot``, ``joints``, ``tool``.
    """

    robot: urdf.Robot
    file: Path | None
    carried: frozenset[str] = frozenset()
    entries: Mapping[str, Any] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from base to tool."""
        return self.robot.joint_names

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the joints with predicted torques and effects, from base to tool."""
        return tuple(joint for joint in self.joints if joint not in self.carried)

    @cached_property
    def model(self) -> pin.Model:
        """The rigid bodies of Pinocchio, without the rotors of an MJCF, which are effects here."""
        model = self.robot.model.copy()
        model.armature = np.zeros(model.nv)
        return model

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint slides instead of turning, from base to tool."""
        return tuple("P" in joint.shortname().removeprefix("JointModel") for joint in list(self.model.joints)[1:])

    @cached_property
    def sliding(self) -> Mapping[str, bool]:
        """Whether each joint slides instead of turning, by its name."""
        return dict(zip(self.joints, self.slides, strict=True))

    @cached_property
    def described(self) -> np.ndarray:
        """(nj, 10) described inertial parameters of the links that the joints move."""
        return described_parameters(self.model)

    @cached_property
    def pseudo_inertia_factors(self) -> np.ndarray:
        """(nj, 4, 4) upper triangular factor U of each link's described pseudo-inertia U U'."""
        return np.array([pseudo_inertia_factor(p, float(self.described[:, 0].max())) for p in self.described])

    @cached_property
    def links_without_mass(self) -> tuple[str, ...]:
        """Moved links without mass, except those between two joints at one place, as in a wrist."""
        between = {
            parent for parent, place in zip(self.model.parents, self.model.jointPlacements, strict=True)
            if not np.any(place.translation)
        }  # fmt: skip
        weightless = {i + 1 for i, mass in enumerate(self.described[:, 0]) if not mass > 0.0} - between
        bodies = {f.parentJoint: f.name for f in reversed(list(self.model.frames)) if f.type == pin.FrameType.BODY}
        return tuple(bodies[joint] for joint in sorted(weightless))

    def reachable_joints(self, reach: Reach) -> tuple[str, ...]:
        """Names of the joints on which an effect with this `reach` can act, or `JOINT_NAME_OF_BASE` for the base."""
        indices = [i for i, joint in enumerate(self.joints) if joint not in self.carried]
        inner = [parent if parent in indices else -1 for parent in parent_joints(self.model)]
        chosen: Mapping[Reach, Iterable[int]] = {
            "every": indices,
            "turning": (i for i in indices if not self.slides[i]),
            "coupled": (i for i in indices if inner[i] >= 0 and self.slides[i] == self.slides[inner[i]]),
            "last": indices[-1:],
            "base": (),
        }
        return (JOINT_NAME_OF_BASE,) if reach == "base" else tuple(self.joints[i] for i in chosen[reach])

    def parameter(self, quantity: Quantity, effect: str, short: str, joint: str) -> Parameter:
        """A parameter of an effect in the units and of the typical size of a joint, or of `JOINT_NAME_OF_BASE`.

        Args:
            quantity: its quantity, for a joint that turns with an effort limit of 50 N m.
            effect: name of the effect.
            short: name of the quantity.
            joint: name of the joint.
        """
        if joint == JOINT_NAME_OF_BASE:
            return quantity.parameter(effect, short)
        i = self.joints.index(joint)
        effort = float(self.model.effortLimit[i])
        torque, angle = _powers(quantity.unit)
        strength = effort / REFERENCE_EFFORT_LIMIT_NM if np.isfinite(effort) else 1.0
        length = EQUIVALENT_METRES_PER_RADIAN if self.slides[i] else 1.0
        scale = strength**torque * length**angle
        unit = sliding_unit(quantity.unit) if self.slides[i] else quantity.unit
        spread = None if quantity.spread is None else quantity.spread * scale
        sizes = {key: getattr(quantity, key) * scale for key in ("typical", "null", "lower", "upper")}
        return replace(quantity, unit=unit, spread=spread, **sizes).parameter(effect, short, joint)


def load_arm_description(
    urdf_path: str | Path | None = None,
    robot: str | None = None,
    joints: Sequence[str] | None = None,
    tool: str | None = None,
) -> Arm:
    """Load an arm from a URDF or by the name of a known robot; joints that are not named are locked at zero.

    Raises:
        InputError: not exactly one of URDF and robot is given, or the description cannot be used.
    """
    if (urdf_path is None) == (robot is None):
        raise InputError("an arm needs its URDF or a known robot's name: give one of urdf and robot")
    if urdf_path is not None and not Path(urdf_path).exists():
        raise InputError(f"{urdf_path}: no such URDF file{files_beside(Path(urdf_path).with_suffix('.urdf'))}")
    chosen = None if joints is None else tuple(joints)
    if chosen is not None and len(chosen) == 0:
        raise InputError("an arm needs at least one joint: name some, or leave them out to take all of the arm")
    try:
        found = urdf.load(str(robot or urdf_path), joints=chosen, tool=tool, meshes=False)
    except urdf.UrdfError as error:
        raise InputError(str(error)) from error
    entries = {"robot": robot, "joints": None if chosen is None else list(chosen), "tool": tool}
    given = {name: entry for name, entry in entries.items() if entry is not None}
    return Arm(found, None if robot is not None else Path(str(urdf_path)).resolve(), entries=given)


def _powers(unit: str) -> tuple[int, int]:
    """Powers of torque and angle in a unit: ``"N m s/rad"`` is torque^1 angle^-1."""
    if unit == "kg m^2":
        return 1, -1
    numerator, _, denominator = unit.partition("/")
    torques, angles = (
        [sum(int(power or 1) for power in re.findall(pattern, part)) for part in (numerator, denominator)]
        for pattern in (r"\bN m()\b", r"\brad(?:\^(\d+))?")
    )
    return torques[0] - torques[1], angles[0] - angles[1]
