"""Read the dynamics of an arm that an MJCF contains and a URDF cannot: gravity, rotors, damping, friction, springs.

An element that acts on the arm in any other way is refused with its name. At the end the torques of the arm's model are
compared with MuJoCo's.
"""

from collections.abc import Collection, Sequence

import mujoco
import numpy as np
import pinocchio as pin

from urdf.mjcf import HINGE, JOINT_TRANSMISSIONS, SLIDE, CompiledMjcf
from urdf.robot import ArmDynamics, Array, JointDynamics, Spring, UrdfError

TORQUE_CHECK_STATES = 5
"""Number of random states at which the model's torques are compared with MuJoCo's."""
RELATIVE_TORQUE_TOLERANCE = 1e-9
"""Allowed difference from MuJoCo's torques, as a share of the largest torque (at least 1 N m or N).

Two equal models differ by 1e-14.
"""
DISABLE_FLAGS = mujoco.mjtDisableBit
JOINT_WRAP, SITE_WRAP = int(mujoco.mjtWrap.mjWRAP_JOINT), int(mujoco.mjtWrap.mjWRAP_SITE)
SHAPE_WRAPS = (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER))
"""MuJoCo's types of tendon parts: joints, sites, and geometries that the tendon wraps around."""
BODY_EQUALITIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
"""MuJoCo's types of equality constraints between two bodies."""


def arm_dynamics_from_mjcf(mjcf: CompiledMjcf, arm: Sequence[str]) -> ArmDynamics:
    """Read gravity, rotor inertia, damping, dry friction and springs of an arm's joints, all other joints fixed at 0.

    Args:
        mjcf: the compiled file.
        arm: names of the arm's joints.

    Raises:
        UrdfError: an element acts on the arm and has no place in the arm's model; the message names it.
    """
    reader = _Reader(mjcf, frozenset(arm))
    for i in range(mjcf.model.njnt):
        reader.add_joint(i)
    for i in range(mjcf.model.nu):
        reader.add_actuator(i)
    for i in range(mjcf.model.ntendon):
        reader.add_tendon(i)
    for i in range(mjcf.model.neq):
        reader.check_equality(i)
    off = mjcf.model.opt.disableflags
    zeroed = {"damping": off & DISABLE_FLAGS.mjDSBL_DAMPER, "friction": off & DISABLE_FLAGS.mjDSBL_FRICTIONLOSS}
    joints = {
        joint: JointDynamics(**{key: 0.0 if zeroed.get(key) else value for key, value in values.items()})
        for joint, values in reader.values.items()
    }
    springs = () if off & DISABLE_FLAGS.mjDSBL_SPRING else tuple(reader.springs)
    return ArmDynamics(reader.gravity(), joints, springs)


def check_torques(mjcf: CompiledMjcf, model: pin.Model, dynamics: ArmDynamics) -> None:
    """Check at random states that the inverse dynamics of an arm's model gives MuJoCo's joint torques.

    Gravity, inertia, springs and damping are compared; dry friction and constraints are switched off in MuJoCo.

    Raises:
        UrdfError: the torques differ.
    """
    compiled, names = mjcf.model.__copy__(), list(model.names)[1:]
    compiled.opt.disableflags |= DISABLE_FLAGS.mjDSBL_CONSTRAINT
    compiled.opt.density = compiled.opt.viscosity = 0.0
    at = [mjcf.joints.index(name) for name in names]
    data, rng = _at_zero(compiled), np.random.default_rng(0)
    damping = np.array([dynamics.joints[name].damping for name in names])
    for _ in range(TORQUE_CHECK_STATES):
        q, v, a = rng.uniform(-1.0, 1.0, (3, len(names)))
        data.qpos[compiled.jnt_qposadr[at]] = q
        data.qvel[compiled.jnt_dofadr[at]] = v
        data.qacc[compiled.jnt_dofadr[at]] = a
        mujoco.mj_inverse(compiled, data)
        own = pin.rnea(model, model.createData(), q, v, a) + damping * v
        for spring in dynamics.springs:
            own[names.index(spring.joint)] += spring.torque(q[names.index(spring.joint)])
        theirs = np.array(data.qfrc_inverse[compiled.jnt_dofadr[at]])
        apart = np.abs(own - theirs)
        if not apart.max() <= RELATIVE_TORQUE_TOLERANCE * max(1.0, float(np.abs(theirs).max())):
            raise UrdfError(
                f"{mjcf.path}: on joint '{names[int(apart.argmax())]}' MuJoCo's torque differs by {apart.max():.2g} "
                "from that of bodies, springs and damping; take out what else acts on it"
            )


def _at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    """MuJoCo's state with all hinges and slides at 0, and other joints as in the file."""
    data = mujoco.MjData(model)
    single = np.isin(model.jnt_type, (HINGE, SLIDE))
    data.qpos[model.jnt_qposadr[single]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


class _Reader:
    """Adds up the additional torques on an arm's joints.

    Attributes:
        values: damping, friction and armature by joint.
        springs: springs of the joints.
    """

    def __init__(self, mjcf: CompiledMjcf, arm: frozenset[str]) -> None:
        self._mjcf, self._m, self._arm = mjcf, mjcf.model, arm
        self.values = {name: {"damping": 0.0, "friction": 0.0, "armature": 0.0} for name in arm}
        self.springs: list[Spring] = []

    def add_joint(self, j: int) -> None:
        m, name = self._m, self._mjcf.joints[j]
        if name not in self._arm:
            return
        dof = int(m.jnt_dofadr[j])
        self._need_proportional(f"joint '{name}'", m.jnt_stiffnesspoly[j], m.dof_dampingpoly[dof], m.jnt_springyield[j])
        self._add(name, 1.0, m.dof_damping[dof], m.dof_frictionloss[dof], m.dof_armature[dof])
        self._add_spring(name, m.jnt_stiffness[j], m.qpos_spring[m.jnt_qposadr[j]])

    def add_actuator(self, i: int) -> None:
        """Add the inertia and the damping of a motor, transformed by its gear ratio."""
        m = self._m
        if not (m.actuator_armature[i] or m.actuator_damping[i] or m.actuator_dampingpoly[i].any()):
            return
        what = self._called(mujoco.mjtObj.mjOBJ_ACTUATOR, "actuator", i)
        if m.actuator_trntype[i] not in JOINT_TRANSMISSIONS:
            raise self._no_place(what, "it has an inertia or a damping of its own and drives no single joint")
        name = self._mjcf.joints[m.actuator_trnid[i, 0]]
        if name in self._arm:
            self._need_proportional(what, m.actuator_dampingpoly[i])
            self._add(name, float(m.actuator_gear[i, 0]), m.actuator_damping[i], 0.0, m.actuator_armature[i])

    def add_tendon(self, i: int) -> None:
        m = self._m
        drive = m.tendon_damping[i], m.tendon_frictionloss[i], m.tendon_armature[i]
        bent = m.tendon_stiffnesspoly[i], m.tendon_dampingpoly[i], m.tendon_springyield[i]
        if not (m.tendon_stiffness[i] or any(drive) or any(map(np.any, bent))):
            return
        what = self._called(mujoco.mjtObj.mjOBJ_TENDON, "tendon", i)
        parts = list(range(m.tendon_adr[i], m.tendon_adr[i] + m.tendon_num[i]))
        low, high = m.tendon_lengthspring[i]
        if m.wrap_type[parts[0]] == JOINT_WRAP:
            ratios = {self._mjcf.joints[m.wrap_objid[k]]: float(m.wrap_prm[k]) for k in parts}
            pulled = [name for name in ratios if name in self._arm and ratios[name]]
        else:
            bodies = [self._holder(k) for k in parts]
            pulled = sorted({name for body in bodies for name in self._apart(body, bodies[0])})
        if not pulled:
            return
        self._need_proportional(what, *bent)
        if len(pulled) > 1 or low != high:
            raise self._no_place(what, f"it pulls on {', '.join(pulled)}, or has a slack")
        (joint,) = pulled
        if m.wrap_type[parts[0]] == JOINT_WRAP:
            self._add(joint, ratios[joint], *drive)
            self._add_spring(joint, m.tendon_stiffness[i] * ratios[joint] ** 2, low / ratios[joint])
            return
        turns = m.jnt_type[self._mjcf.joints.index(joint)] == HINGE
        sites = len(parts) == 2 and all(m.wrap_type[k] == SITE_WRAP for k in parts)
        if not (turns and sites) or low or any(drive):
            raise self._no_place(what, "only a spring of length 0 between two sites across a hinge is known")
        self._add_gravity_spring(joint, float(m.tendon_stiffness[i]), [int(m.wrap_objid[k]) for k in parts])

    def check_equality(self, i: int) -> None:
        """Refuse an equality constraint between a part of the arm and a part that moves differently."""
        m = self._m
        if not m.eq_active0[i] or m.eq_type[i] not in BODY_EQUALITIES:
            return
        ends = [int(m.eq_obj1id[i]), int(m.eq_obj2id[i])]
        if m.eq_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(m.site_bodyid[end]) for end in ends]
        if self._apart(*ends):
            what = self._called(mujoco.mjtObj.mjOBJ_EQUALITY, "equality constraint", i)
            raise self._no_place(what, "it closes a loop through the arm")

    def gravity(self) -> Array:
        """Gravity (3,) [m/s^2], reduced by the share that MuJoCo's ``gravcomp`` compensates on the arm's bodies.

        Raises:
            UrdfError: bodies have different shares.
        """
        m = self._m
        gravity = np.zeros(3) if m.opt.disableflags & DISABLE_FLAGS.mjDSBL_GRAVITY else np.array(m.opt.gravity)
        moved = [b for b in range(1, m.nbody) if m.body_mass[b] > 0.0 and self._apart(b, 0)]
        shares = m.body_gravcomp[moved]
        by_drives = m.jnt_actgravcomp[[j for j, name in enumerate(self._mjcf.joints) if name in self._arm]]
        # The torque that compensates gravity is a part of the drives' torque.
        if not gravity.any() or not shares.any() or by_drives.all():
            return gravity
        odd = np.flatnonzero(shares != shares[0])
        if by_drives.any() or odd.size:
            body = self._mjcf.bodies[moved[odd[0] if odd.size else 0]]
            raise self._no_place(f"body '{body}'", "its gravcomp is not that of all other bodies and joints of the arm")
        return gravity * (1.0 - float(shares[0]))

    def _add(self, joint: str, ratio: float, damping: float, friction: float, armature: float) -> None:
        values = self.values[joint]
        values["damping"] += float(damping) * ratio**2
        values["friction"] += float(friction) * abs(ratio)
        values["armature"] += float(armature) * ratio**2

    def _add_spring(self, joint: str, stiffness: float, rest: float) -> None:
        if stiffness:
            spring = Spring(joint, 0.0, 0.0, True, "stiffness of the MJCF", float(stiffness), float(rest))
            self.springs.append(spring)

    def _add_gravity_spring(self, joint: str, stiffness: float, sites: Sequence[int]) -> None:
        """Add a spring between two sites, one of which a hinge turns.

        With a and b from its axis n to the fixed and the turned end, both at q = 0, E = k/2 |a - R(q) b|^2, and the
        drive holds dE/dq = k (a.b - (a.n)(b.n)) sin q - k a.(n x b) cos q.
        """
        m, j, data = self._m, self._mjcf.joints.index(joint), _at_zero(self._m)
        fixed, turned = sorted(sites, key=lambda site: joint in self._movers(int(m.site_bodyid[site])))
        n, a, b = data.xaxis[j], *(data.site_xpos[site] - data.xanchor[j] for site in (fixed, turned))
        sine, cosine = a @ b - (a @ n) * (b @ n), -(a @ np.cross(n, b))
        self.springs.append(
            Spring(joint, float(stiffness * sine), float(stiffness * cosine), True, "a tendon of the MJCF")
        )

    def _holder(self, wrap: int) -> int:
        """Index of the body that a part of a tendon is on; the world for a pulley."""
        m = self._m
        if m.wrap_type[wrap] == SITE_WRAP:
            return int(m.site_bodyid[m.wrap_objid[wrap]])
        return int(m.geom_bodyid[m.wrap_objid[wrap]]) if m.wrap_type[wrap] in SHAPE_WRAPS else 0

    def _movers(self, body: int) -> set[str]:
        """Joints that move a body."""
        m, found = self._m, set[str]()
        while body:
            found.update(self._mjcf.joints[j] for j in np.flatnonzero(m.jnt_bodyid == body))
            body = int(m.body_parentid[body])
        return found

    def _apart(self, one: int, other: int) -> Collection[str]:
        """Joints of the arm that move one body and not the other."""
        return (self._movers(one) ^ self._movers(other)) & self._arm

    def _need_proportional(self, what: str, *others: Array) -> None:
        if any(map(np.any, others)):
            raise self._no_place(what, "its spring or damping is not proportional")

    def _no_place(self, what: str, why: str) -> UrdfError:
        return UrdfError(f"{self._mjcf.path}: {what} has no place in the model of an arm, as {why}; take it out")

    def _called(self, kind: mujoco.mjtObj, word: str, i: int) -> str:
        found = mujoco.mj_id2name(self._m, kind, i)
        return f"{word} '{found}'" if found else f"{word} {i + 1}"
