"""What hangs from the gripper and where it should end, as parts of MuJoCo's model: load, string, box."""

import mujoco
import numpy as np

from pipeline.robot.line_frame import LineFrame
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import Box, PlantSettings

# MuJoCo's default limit is so soft that the string loses 5 % of the swing's energy in 15 s. This one stretches by
# 0.2 mm under 80 g (4 kN/m) and loses 0.1 %; a harder one would need a shorter step.
STRING_SOLREF = (-25000.0, -100.0)
STRING_SOLIMP = (0.5, 0.5, 1e-4, 0.5, 2.0)

# MuJoCo's default contact lets a load at 2 m/s sink in by its own radius; with this one it is a quarter of that.
CONTACT_SOLREF = (0.005, 1.0)


def add_load(
    spec: mujoco.MjSpec, tool: mujoco.MjsBody, offset: Vector, settings: PlantSettings, mass: float, inertia: float
) -> None:
    """A free sphere; with an inertia of its own, a sphere sliding on a massless bar that turns about the pivot.

    Without it the string holds the sphere's centre and the sphere does not turn with it.
    """
    below = float(settings.length)
    if inertia > 0:
        bar = tool.add_body(name="bar", pos=offset, mass=1e-9, inertia=[inertia, inertia, 1e-9], explicitinertial=True)
        bar.ipos = np.zeros(3)
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
    """A cord that only pulls: a tendon with an upper limit of its length."""
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


def make_elastic(model: mujoco.MjModel, compliance: float) -> None:
    """Replace the limit by a spring [m/N] that acts beyond the string's length only."""
    string = model.tendon("string").id
    model.tendon_lengthspring[string] = model.tendon_range[string]
    model.tendon_limited[string] = 0
    stiffness = model.tendon_stiffness
    # MuJoCo 4 has room for a polynomial; the linear coefficient comes first.
    stiffness.reshape(model.ntendon, -1)[string, 0] = 1.0 / compliance


def add_box(spec: mujoco.MjSpec, line: LineFrame, box: Box) -> None:
    """Four walls and a floor, fixed in the world, aligned with the line."""
    up = np.array([0.0, 0.0, 1.0])
    half = box.wall / 2
    rim = line.origin - box.rim * up
    middle = rim + (box.near_wall + box.width / 2) * line.along
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.column_stack([line.along, line.across, up]).ravel())
    side = -box.height / 2 * up
    w, d, h = box.width / 2, box.depth / 2, box.height / 2
    plates = {
        "near": (side - w * line.along, (half, d + half, h)),
        "far": (side + w * line.along, (half, d + half, h)),
        "left": (side - d * line.across, (w + half, half, h)),
        "right": (side + d * line.across, (w + half, half, h)),
        "floor": (-(box.height + half) * up, (w + half, d + half, half)),
    }
    for name, (offset, size) in plates.items():
        spec.worldbody.add_geom(
            name=f"box_{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=middle + offset,
            quat=quaternion,
            size=size,
            friction=[box.friction, 0.005, 0.0005],
            priority=1,
            solref=CONTACT_SOLREF,
            condim=4,
            rgba=[0.55, 0.40, 0.25, 0.6],
        )
