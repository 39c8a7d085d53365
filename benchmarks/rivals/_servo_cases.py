"""Recordings of a servo arm, a SO-101: simulated in MuJoCo, where the truth is known, and of the real arm.

The simulated one has position servos of 11.5 N m/rad with a limit, viscous and dry friction, rotors, and play in the
elbow; its encoders have 4096 steps a turn, and commands and positions are recorded 30 times a second.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

sys.path.append(str(Path(__file__).resolve().parents[1]))
import mujoco
import numpy as np
from _hidden_table import generator

import urdf
from armdyn.run import Run, read_run
from urdf.find import distribution_file

bare = generator("mujoco_plant").bare

RECORDED, SIMULATED = "recorded SO-101", "SO-101 in MuJoCo"
"""Names of the cases."""
DESCRIPTION = "so_arm_description/urdf/so101.urdf"
"""The arm in example-robot-data."""
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
FINGER = "gripper"  # moves as well, and is not recorded
GAIN, DAMPING, FRICTION, ROTOR, LIMIT = 11.5, 0.25, 0.09, 0.011, 3.3
"""Of every joint: N m/rad, N m s/rad, N m, kg m^2, N m."""
SERVO_DAMPING = 0.05  # of the damping, N m s/rad, that of the servo
PLAYING, PLAY = "elbow_flex", 0.010  # rad to either side
PLAY_ARMATURE, PLAY_DAMPING = 1e-4, 0.005  # kg m^2, N m s/rad
STEP, FPS, SEED, EPISODES = 5e-4, 30, 4, 3
ENCODER = 2.0 * np.pi / 4096.0
TRAINING = ("multisine", "chirp_sweep", "symmetric_motion", "trapezoidal_profile", "inertia_coupling")
HELD_OUT = ("frequency_sweep", "lissajous_pattern", "spiral_motion", "staircase_motion", "wave_motion")
"""Recordings of the real arm."""


@dataclass(frozen=True)
class ServoCase:
    """Recordings of one arm.

    Attributes:
        name: what is recorded.
        urdf: path of the arm's description.
        training: recordings that are fitted.
        held_out: recordings that are predicted.
        playing: the joint with play, None without.
        truth: value by parameter of armdyn's model, `GAIN_NAME` for the servos' gain; empty where nobody knows it.
    """

    name: str
    urdf: Path
    training: tuple[Run, ...]
    held_out: tuple[Run, ...]
    playing: str | None
    truth: Mapping[str, float]


GAIN_NAME, PLAY_NAME = "gain", f"backlash.play[{PLAYING}]"
FRICTIONS = {
    "joint_viscous_friction.coefficient": DAMPING,
    "joint_coulomb_friction.torque": FRICTION,
    "rotor_inertia.inertia": ROTOR,
}
"""Values of the simulated arm, equal on all joints, by name without the joint."""


def recorded(folder: Path) -> ServoCase:
    """The real arm.

    Args:
        folder: holds the recordings, ``<name>.csv``, and ``so101.urdf``.

    Raises:
        InputError: a recording is missing or cannot be read.
    """
    training, held_out = (tuple(read_run(folder / f"{name}.csv") for name in names) for names in (TRAINING, HELD_OUT))
    return ServoCase(RECORDED, folder / "so101.urdf", training, held_out, None, {})


def simulated(seconds: float = 40.0) -> ServoCase:
    """The arm that MuJoCo moves for `seconds` in each of three recordings, of which the last is held out."""
    path = distribution_file("example-robot-data", DESCRIPTION)
    model, rng = _plant(urdf.load(path, meshes=False).urdf_xml), np.random.default_rng(SEED)
    runs = tuple(_episode(model, rng, seconds, f"episode_{k}") for k in range(EPISODES))
    truth = {f"{name}[{joint}]": value for name, value in FRICTIONS.items() for joint in JOINTS}
    truth |= {GAIN_NAME: GAIN, PLAY_NAME: PLAY}
    return ServoCase(SIMULATED, Path(path), runs[:-1], runs[-1:], PLAYING, truth)


def _plant(xml: str) -> mujoco.MjModel:
    root = bare(xml, (*JOINTS, FINGER))
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-6", "boundinertia": "1e-9"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in (*JOINTS, FINGER):
        joint = spec.joint(name)
        joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.frictionloss, joint.armature = FRICTION, ROTOR
        joint.damping = np.array([DAMPING - SERVO_DAMPING, 0.0, 0.0])
        joint.solref_friction, joint.solimp_friction = [4 * STEP, 1.0], [0.98, 0.999, 0.001, 0.5, 2.0]
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gainprm[0], servo.biastype = GAIN, mujoco.mjtBias.mjBIAS_AFFINE
        servo.biasprm[1:3] = -GAIN, -SERVO_DAMPING
        servo.forcelimited, servo.forcerange = True, [-LIMIT, LIMIT]
    add_play(spec, PLAYING, PLAY)
    return spec.compile()


def add_play(spec: mujoco.MjSpec, joint: str, size: float) -> None:
    """Add a second joint, ``<joint>_play``, between a drive and its link, `size` rad wide to either side."""
    body = next(b for b in spec.bodies if any(j.name == joint for j in b.joints))
    drive = next(j for j in body.joints if j.name == joint)
    play = body.add_joint(name=f"{joint}_play", type=drive.type, axis=drive.axis, range=[-size, size])
    play.limited, play.armature = mujoco.mjtLimited.mjLIMITED_TRUE, PLAY_ARMATURE
    play.damping = np.array([PLAY_DAMPING, 0.0, 0.0])


def _episode(model: mujoco.MjModel, rng: np.random.Generator, seconds: float, name: str) -> Run:
    """Recorded motion along three sines a joint."""
    drives = (*JOINTS, FINGER)
    size, rate = rng.uniform(0.2, 0.55, (3, len(drives))), rng.uniform(0.05, 0.45, (3, len(drives)))
    phase, data = rng.uniform(0.0, 2.0 * np.pi, (3, len(drives))), mujoco.MjData(model)
    place = {joint: int(model.joint(joint).qposadr[0]) for joint in (*drives, f"{PLAYING}_play")}
    time = np.arange(round(seconds * FPS)) / FPS
    fade = np.clip(np.minimum(time, seconds - time) / 2.0, 0.0, 1.0)[:, None]
    waves = (size * np.sin(2.0 * np.pi * rate * time[:, None, None] + phase)).sum(axis=1)
    told = np.round(fade**2 * (3.0 - 2.0 * fade) * waves / ENCODER) * ENCODER
    q, frame = np.empty((len(time), len(JOINTS))), 0
    for k in range(round(seconds / STEP)):
        if frame < len(time) and k * STEP >= time[frame] - 1e-9:
            q[frame] = [data.qpos[place[joint]] for joint in JOINTS]
            q[frame, JOINTS.index(PLAYING)] += data.qpos[place[f"{PLAYING}_play"]]
            data.ctrl[:] = told[frame]
            frame += 1
        mujoco.mj_step(model, data)
    columns = {f"q.{joint}": np.round(q[:, j] / ENCODER) * ENCODER for j, joint in enumerate(JOINTS)}
    columns |= {f"q_cmd.{joint}": told[:, j] for j, joint in enumerate(JOINTS)}
    return Run.from_arrays(time, columns, name=name, joints=None)
