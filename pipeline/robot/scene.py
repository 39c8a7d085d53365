"""MuJoCo model of arm, string, load and box, made from the text of the arm's URDF."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mujoco
import numpy as np

import urdf
from armdyn.errors import InputError
from armdyn.pendulum.physics import STANDARD_GRAVITY
from pipeline.box import Box
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings

# MuJoCo's default limit is so soft that the string loses 5 % of the swing's energy in 15 s. This one stretches by
# 0.2 mm under 80 g (4 kN/m) and loses 0.1 %; a harder one would need a shorter step.
STRING_SOLREF = (-25000.0, -100.0)
STRING_SOLIMP = (0.5, 0.5, 1e-4, 0.5, 2.0)

# MuJoCo's default contact lets a load at 2 m/s sink in by its own radius; with this one it is a quarter of that.
CONTACT_SOLREF = (0.005, 1.0)


GIVING_MASS, GIVING_DAMPING_RATIO = 5e-3, 0.5
"""Mass [kg] and damping ratio of the part of a compliant gripper that carries the string's upper end."""


def add_string_end(tool: mujoco.MjsBody, offset: Vector, compliance: float) -> tuple[mujoco.MjsBody, Vector]:
    """Add the string's upper end, the site ``pivot``: fixed to the gripper, or on a spring along its line.

    Args:
        tool: body of the gripper.
        offset: position of the string's upper end in the frame of `tool` (3,) [m].
        compliance: displacement along the line per force [m/N]; `place_at_rest` sets the direction.

    Returns:
        The body from which the string hangs, and the string's upper end in its frame (3,) [m].
    """
    if compliance > 0:
        tool = tool.add_body(
            name="giving", pos=offset, mass=GIVING_MASS, inertia=np.full(3, 1e-9), explicitinertial=True
        )
        tool.ipos = np.zeros(3)
        spring = tool.add_joint(name="giving", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0])
        spring.stiffness = np.array([1.0 / compliance, 0.0, 0.0])[: np.size(spring.stiffness)]
        damping = 2.0 * GIVING_DAMPING_RATIO * np.sqrt(GIVING_MASS / compliance)
        spring.damping = np.array([damping, 0.0, 0.0])[: np.size(spring.damping)]
        offset = np.zeros(3)
    tool.add_site(name="pivot", pos=offset)
    return tool, offset


def add_load(
    spec: mujoco.MjSpec,
    tool: mujoco.MjsBody,
    offset: Vector,
    settings: PlantSettings,
    mass: float,
    inertia: float,
    string_mass: float = 0.0,
) -> None:
    """Add the load, a sphere.

    Args:
        spec: MuJoCo specification to change.
        tool: body from which the string hangs.
        offset: position of the string's upper end in the frame of `tool` (3,) [m].
        settings: settings with the string's length and the load's radius.
        mass: mass of the load [kg].
        inertia: moment of inertia about its centre with which the load turns together with the string [kg m^2]; the
            load then slides on a bar. Zero for a free sphere that does not turn with the string.
        string_mass: mass of the string, which is then that bar [kg]; zero for a massless string.
    """
    below = float(settings.length)
    if inertia > 0 or string_mass > 0:
        across = inertia + string_mass * below**2 / 12.0
        bar = tool.add_body(
            name="bar", pos=offset, mass=max(string_mass, 1e-9), inertia=[across, across, 1e-9], explicitinertial=True
        )
        bar.ipos = np.array([0.0, 0.0, below / 2.0 if string_mass > 0 else 0.0])
        bar.add_joint(name="turn", type=mujoco.mjtJoint.mjJNT_BALL)
        load = bar.add_body(name="load", pos=[0.0, 0.0, below])
        load.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
        own = 1e-9
    else:
        load = spec.worldbody.add_body(name="load", pos=[0.0, 0.0, -below])
        load.add_freejoint(name="load")
        own = 0.4 * mass * settings.load_radius**2
    load.mass, load.inertia, load.ipos, load.explicitinertial = mass, np.full(3, own), np.zeros(3), True
    load.add_geom(
        name="load",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[settings.load_radius, 0, 0],
        condim=4,
        rgba=[0.8, 0.1, 0.1, 1],
    )
    load.add_site(name="load")


def add_string(spec: mujoco.MjSpec, length: float) -> None:
    """Add the string as a tendon whose length has an upper limit `length` [m]."""
    string = spec.add_tendon(name="string", width=0.0015, rgba=[0.1, 0.1, 0.1, 1])
    string.wrap_site("pivot")
    string.wrap_site("load")
    string.limited = True
    string.range = [0.0, length]
    string.solref_limit, string.solimp_limit = STRING_SOLREF, STRING_SOLIMP
    spec.add_sensor(
        name="tension",
        type=mujoco.mjtSensor.mjSENS_TENDONLIMITFRC,
        objtype=mujoco.mjtObj.mjOBJ_TENDON,
        objname="string",
    )


def make_string_elastic(model: mujoco.MjModel, compliance: float) -> None:
    """Replace the string's limit by a spring of a compliance [m/N] that acts beyond the string's length only."""
    string = model.tendon("string").id
    model.tendon_lengthspring[string] = model.tendon_range[string]
    model.tendon_limited[string] = 0
    stiffness = model.tendon_stiffness
    # MuJoCo 4 has room for a polynomial; the linear coefficient comes first.
    stiffness.reshape(model.ntendon, -1)[string, 0] = 1.0 / compliance


def add_box(spec: mujoco.MjSpec, line: urdf.Line, box: Box) -> None:
    """Add the box: four walls and a floor, fixed in the world and aligned with the gripper's line."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, line.axes.ravel())
    for plate in box.plates(line):
        spec.worldbody.add_geom(
            name=f"box_{plate.name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=plate.centre,
            quat=quaternion,
            size=plate.half,
            friction=[box.friction, 0.005, 0.0005],
            priority=1,
            solref=CONTACT_SOLREF,
            condim=4,
            rgba=[0.55, 0.40, 0.25, 0.6],
        )


TIME_STEP = 1e-3
"""Time step of the simulation [s]."""
LOCKED_JOINT_ARMATURE = 1e6
"""Rotor inertia that keeps a joint from moving [kg m^2]."""


def build_scene(
    robot: urdf.Robot, settings: PlantSettings, hidden: Mapping[str, float], mass: float, link_scale: Vector
) -> mujoco.MjModel:
    """MuJoCo model of the simulated robot, with the names ``string``, ``pivot`` (the string's upper end) and ``load``.

    Args:
        robot: description of the arm.
        settings: settings of the simulated robot.
        hidden: size of every hidden effect.
        mass: true mass of the load [kg].
        link_scale: factors on mass and inertia of the link behind each joint (n,).

    Raises:
        InputError: the gripper's line is not horizontal, or the arm has no link for the string.
    """
    spec = mujoco.MjSpec.from_string(ET.tostring(arm_only_urdf(robot), encoding="unicode"))
    line = robot.line
    if abs(line.direction[2]) > 1e-6:  # a swing along this line would not be the paper's
        raise InputError(
            f"robot '{robot.name}': the line's direction {line.direction} is not horizontal; give one with z = 0"
        )
    _set_options(spec, line, hidden["path_tilt"])
    tool = spec.body(robot.tool_frame)
    if tool is None:
        raise InputError(f"robot '{robot.name}': its URDF has no link '{robot.tool_frame}' to hang the string from")
    link_scale = link_scale * (1.0 + hidden["link_inertia"])
    if hidden["payload"] > 0:
        # The compiler joins the payload to the last link, whose mass is scaled afterwards.
        tool.add_body(
            name="payload",
            mass=hidden["payload"] / link_scale[-1],
            inertia=np.full(3, 1e-9),
            ipos=np.zeros(3),
            explicitinertial=True,
        )
    _add_motors(spec, robot, settings, hidden["gripper_lag"])
    end, place = add_string_end(tool, robot.tool_offset, hidden["gripper_compliance"])
    add_load(spec, end, place, settings, mass, hidden["load_inertia"], hidden["string_mass"])
    add_string(spec, settings.length)
    if settings.box is not None:
        add_box(spec, line, settings.box)
    model = spec.compile()
    if hidden["string_elasticity"] > 0:
        make_string_elastic(model, hidden["string_elasticity"])
    _tune_joints(model, robot, settings, hidden, link_scale)
    return model


def arm_only_urdf(robot: urdf.Robot, keep: tuple[str, ...] = ()) -> ET.Element:
    """URDF of a robot in which only the arm's joints move; all other joints are fixed at zero.

    Args:
        robot: description of the robot.
        keep: kinds of shapes to keep, "visual" or "collision"; other shapes are removed.
    """
    root = ET.fromstring(robot.urdf_xml)
    for link in root.iter("link"):
        for kind in {"visual", "collision"}.difference(keep):
            for shape in link.findall(kind):
                link.remove(shape)
    for joint in root.findall("joint"):
        if joint.get("name") not in robot.joint_names:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    return root


def _set_options(spec: mujoco.MjSpec, line: urdf.Line, tilt: float) -> None:
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.gravity = STANDARD_GRAVITY * line.axes @ (np.sin(tilt), 0.0, -np.cos(tilt))
    # MuJoCo measures its solver's progress against the mean inertia, beside which the load's is small: with the
    # default of 1e-8 the string's pull is 8 mN rms off while the joints are made rigid.
    spec.option.tolerance = 1e-12
    # MuJoCo must not set a diverged state back to the start.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _add_motors(spec: mujoco.MjSpec, robot: urdf.Robot, settings: PlantSettings, gripper_lag: float) -> None:
    """Add a motor per joint with the force ``ctrl - stiffness q - damping v``.

    In this form MuJoCo integrates the stiff part implicitly and clamps the sum at the URDF's effort limit;
    `devices` computes ``ctrl``. The encoders lead the gripper by `gripper_lag` [s] and the servo regulates what they
    report, q + gripper_lag v.
    """
    servo = settings.servo
    for i, name in enumerate(robot.joint_names):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0] = 1.0
        motor.biasprm[1] = -servo.stiffness[i]
        motor.biasprm[2] = -(servo.damping[i] + gripper_lag * servo.stiffness[i])


def _tune_joints(
    model: mujoco.MjModel, robot: urdf.Robot, settings: PlantSettings, hidden: Mapping[str, float], link_scale: Vector
) -> None:
    """Set friction, rotor and link inertia of each joint, which MuJoCo reads from its model at every step."""
    servo = settings.servo
    share = relative_effort_limits(robot)
    for i, name in enumerate(robot.joint_names):
        joint = model.joint(name)
        dof, body = joint.dofadr[0], joint.bodyid[0]
        armature = servo.armature[i] + hidden["rotor_inertia"] * share[i]
        model.dof_armature[dof] = LOCKED_JOINT_ARMATURE if settings.rigid_arm else armature
        model.dof_frictionloss[dof] = servo.friction[i] + hidden["joint_coulomb_friction"] * share[i]
        model.dof_damping[dof] += hidden["joint_viscous_friction"] * share[i]
        model.body_mass[body] *= link_scale[i]
        model.body_inertia[body] *= link_scale[i]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def relative_effort_limits(robot: urdf.Robot) -> Vector:
    """Effort limit of each joint divided by that of the strongest joint (n,); it scales hidden friction and rotors."""
    return robot.limits.effort / robot.limits.effort.max()
