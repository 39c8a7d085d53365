"""Servo arms that MuJoCo simulates: what they are told and where they go, and what their description lacks.

The first five joints of four robots of example-robot-data. Drives are MuJoCo's actuators, those of the joints that
carry most of one kind, the others of another; they are told something new at every sample, which acts late. Hidden are
damping, dry friction, armature, offsets, a load, play between a drive and its link, and a spring between them, which no
catalogue has. The last of every `PERIOD` arms are as described but for masses, centres and extents that are off;
their position drives have a damping, which is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from armdyn.run import Run

from .mujoco_arm import robot_of
from .mujoco_plant import STEP, Hidden, Path, bare, compiled, rigid_torques, with_links_off

ROBOTS = ("z1", "xarm7", "ur5", "panda")  # the seeds take them in turn
LAWS = ("position", "position", "velocity", "torque")  # the same, four robots each
JOINTS, PERIOD, CLEAN = 5, 40, 8  # of all arms, so many clean ones
RATES = (40.0, 50.0, 100.0, 200.0)  # Hz, divisors of 1 / STEP
SECONDS = (20.0, 20.0, 20.0)  # the last is held out
ROLES = ("run 0", "run 1", "held out")
SLOW, FAST = (0.05, 0.4), (0.1, 0.5)  # Hz of training, and of the held-out run
DROOP: Mapping[str, tuple[float, float]] = {
    "position": (0.03, 0.1), "velocity": (0.1, 0.3), "torque": (0.8, 1.25),
}  # fmt: skip
"""Error by which a drive carries the largest load of its kind, rad and rad/s; the gain of one that is told torques."""
DAMPED, DELAY, SAG, TURN = (0.3, 0.8), (0.0, 0.03), 0.15, (4096, 16384, 65536)
SHARE, LEAST, ON = (0.05, 0.25), 0.15, 0.8  # of the joint's largest load, at least of its kind's; share of joints
CARRIED, PLACE = (0.03, 0.1), 0.06  # of the arm's mass; m
PLAY, GIVES = (0.005, 0.015), (0.003, 0.006)  # rad; rad of a spring under the largest load
OUTSIDE, HELPLESS = 1.2, 0.5  # Hz of a loop around drives that are told velocities or torques; share at the limit
SEEN = 2.0
"""A hidden effect is visible if the motion of the first run is so many encoder noises away without it, rms."""


@dataclass(frozen=True)
class ServoArm:
    """One arm."""

    seed: int
    robot: str
    law: str
    joints: tuple[str, ...]
    exact: str  # URDF of the simulated links
    description: str  # URDF that its user has
    known: dict[str, dict[str, Any]]  # tables of its drives as its user has them
    drives: dict[str, dict[str, Any]]  # as they are
    hidden: tuple[Hidden, ...]
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class _Drives:
    """(nj,) gains and limits of drives with one law, their delay in steps, steps of a sample, share of the supply."""

    law: str
    gain: np.ndarray
    limit: np.ndarray
    late: int
    every: int
    period: float  # s of the supply's sag; infinite without
    damping: np.ndarray


def generate(seed: int) -> ServoArm:
    """The arm of a seed; another one where its drives cannot hold it on its path."""
    rng = np.random.default_rng([seed, 81])
    name, law, clean = ROBOTS[seed % 4], LAWS[seed // 4 % 4], seed % PERIOD >= PERIOD - CLEAN
    robot = robot_of(name)
    joints = robot.joint_names[:JOINTS]
    plain = bare(robot.urdf_xml, joints)
    exact = ET.tostring(plain, encoding="unicode")
    description = ET.tostring(with_links_off(plain, rng), encoding="unicode") if clean else exact
    paths = [Path.drawn(rng, robot, FAST if k == 2 else SLOW, lasts) for k, lasts in enumerate(SECONDS)]
    bodies = compiled(exact, joints)
    way = [np.vstack(parts)[:, :JOINTS] for parts in zip(*(p.at(np.arange(0, 20, 0.1)) for p in paths), strict=True)]
    load = np.abs(rigid_torques(bodies, joints, (way[0], 0 * way[1], 0 * way[2]))).max(axis=0)
    at, still = np.tile(way[0].mean(axis=0), (JOINTS, 1)), np.zeros((JOINTS, JOINTS))
    pushed, held = (rigid_torques(bodies, joints, (at, still, a)) for a in (np.eye(JOINTS), still))
    inertia = np.diag(pushed - held)
    strong = load > 0.3 * load.max()
    every = round(1.0 / float(rng.choice(RATES)) / STEP)
    sags, limited, reached = rng.random(3) < (0.3, 0.5, 0.3)
    delay = round(rng.uniform(*DELAY) / STEP)
    known, drives = dict[str, dict[str, Any]](), dict[str, dict[str, Any]]()
    gain, limit, largest = np.zeros(JOINTS), np.full(JOINTS, np.inf), np.zeros(JOINTS)
    damping = np.zeros(JOINTS)
    for kind, members in (("shoulder", strong), ("wrist", ~strong)):
        own, peak = [joint for joint, is_in in zip(joints, members, strict=True) if is_in], float(load[members].max())
        largest[members] = np.maximum(load[members], LEAST * peak)
        droop = rng.uniform(*DROOP[law])
        gain[members] = droop if law == "torque" else peak / droop
        unit = {"position": "N m/rad", "velocity": "N m s/rad", "torque": "1"}[law]
        if limited:
            limit[members] = peak * (rng.uniform(1.2, 1.4) if reached else rng.uniform(1.5, 2.0))
        table: dict[str, Any] = {"joints": own, "law": law} | ({"supply": "12 V"} if sags else {})
        if clean and law == "position":
            damping[members] = 2.0 * max(DAMPED) * np.sqrt(gain[members] * inertia[members].max())
            table["damping"] = f"{damping[members][0]:.10g} N m s/rad"
        most = {"limit": f"{limit[members][0]:.6g} N m"} if limited else {}
        told = f"{gain[members][0] * rng.normal(1.0, 0.05):.6g} {unit} +/- 5 %"
        # A wrist's gain is known: hardly any weight shows it.
        known[kind] = table | most | ({"gain": told} if kind == "wrist" or rng.random() < 0.5 else {})
        drives[kind] = table | most | {"gain": f"{gain[members][0]:.10g} {unit}", "delay": f"{delay * STEP:.6g} s"}
    moved = _Drives(law, gain, limit, delay, every, rng.uniform(3.0, 9.0) if sags else np.inf, damping)
    hidden, spring = (
        ((), None) if clean else _drawn(rng, inertia, float(bodies.body_mass.sum()), joints, way, largest, moved)
    )
    encoder = 2 * np.pi / float(rng.choice(TURN))
    try:
        logs = [_recorded(exact, joints, path, moved, hidden, spring) for path in paths]
    except FloatingPointError:
        return replace(generate(seed + 1_000_000), seed=seed)
    seen = []
    for one in hidden:
        others = tuple(other for other in hidden if other is not one)
        try:
            away = _recorded(exact, joints, paths[0], moved, others, spring, logs[0][1])[0] - logs[0][0]
        except FloatingPointError:
            away = np.full((1, 1), np.inf)
        size = float(np.sqrt(np.mean(away**2, axis=0)).max())
        seen.append(replace(one, size=size, visible=size > SEEN * encoder / np.sqrt(12.0)))
    channel, runs = {"position": "q_cmd", "velocity": "v_cmd", "torque": "tau_ff"}[law], []
    for role, (q, told) in zip(ROLES, logs, strict=True):
        time = STEP * every * np.arange(len(q))
        columns = {f"q.{j}": np.round(q[:, i] / encoder) * encoder for i, j in enumerate(joints)}
        columns |= {f"{channel}.{j}": told[:, i] for i, j in enumerate(joints)}
        columns |= {f"voltage.{j}": 12.0 * _supply(moved, time) for j in joints} if sags else {}
        runs.append(Run.from_arrays(time, columns, name=role, joints=None))
    return ServoArm(seed, name, law, joints, exact, description, known, drives, tuple(seen), tuple(runs))


def _drawn(
    rng: np.random.Generator, inertia: np.ndarray, mass: float, joints: tuple[str, ...], way: list[np.ndarray],
    largest: np.ndarray, drives: _Drives,
) -> tuple[tuple[Hidden, ...], tuple[str, float] | None]:  # fmt: skip
    """What is hidden, and a joint with a spring between drive and link, N m/rad."""
    speed, brisk = (np.sqrt(np.mean(x**2, axis=0)) for x in way[1:])
    sized = rng.random(4) < (0.7, 0.6, 0.3, 0.4)  # dry friction, rotors, offsets, a load
    hidden = []
    for j, joint in enumerate(joints):
        size = largest[j] * rng.uniform(*SHARE, 4)
        rotor = float(min(size[2] / brisk[j], 5.0 * inertia[j]))
        viscous = float(size[0] / speed[j])
        if drives.law == "position":
            whole = inertia[j] + (rotor if sized[1] else 0.0)
            viscous = float(2.0 * rng.uniform(*DAMPED) * np.sqrt(drives.gain[j] * whole))
        on, sign = rng.random(2) < ON, float(rng.choice([-1.0, 1.0]))
        hidden.append(Hidden("joint_viscous_friction", joint, {"coefficient": viscous}))
        hidden += [Hidden("joint_coulomb_friction", joint, {"torque": float(size[1])})] if sized[0] and on[0] else []
        hidden += [Hidden("rotor_inertia", joint, {"inertia": rotor})] if sized[1] else []
        hidden += [Hidden("torque_offset", joint, {"torque": sign * float(size[3])})] if sized[2] and on[1] else []
    if sized[3]:
        place = dict(zip("xyz", rng.uniform(-PLACE, PLACE, 3).tolist(), strict=True))
        hidden.append(Hidden("payload", joints[-1], {"mass": float(mass * rng.uniform(*CARRIED)), **place}))
    which, share = int(rng.integers(1, JOINTS)), rng.random()
    if drives.law == "position" and share < 0.25:
        hidden.append(Hidden("backlash", joints[which], {"play": float(rng.uniform(*PLAY))}))
    elif drives.law == "position" and share < 0.4:
        return tuple(hidden), (joints[which], float(largest[which] / rng.uniform(*GIVES)))
    return tuple(hidden), None


def _supply(drives: _Drives, time: np.ndarray) -> np.ndarray:
    """Share of its voltage that a supply has."""
    return 1.0 - SAG * np.abs(np.sin(2 * np.pi * time / drives.period))


def _plant(
    exact: str, joints: tuple[str, ...], hidden: tuple[Hidden, ...], spring: tuple[str, float] | None, drives: _Drives
) -> mujoco.MjModel:
    """The arm with its actuators; a joint with play or a spring has a second one, ``"<joint>_gap"``."""
    root = ET.fromstring(exact)
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-9", "boundinertia": "1e-12"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    for joint in spec.joints:
        joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the drives alone are limited
    value = {(one.effect, one.joint): one.values for one in hidden}
    for name, k, d, most in zip(joints, drives.gain, drives.damping, drives.limit, strict=True):
        joint = spec.joint(name)
        joint.damping = np.array(
            [value.get(("joint_viscous_friction", name), {"coefficient": 0.0})["coefficient"], 0, 0]
        )
        joint.frictionloss = value.get(("joint_coulomb_friction", name), {"torque": 0.0})["torque"]
        joint.armature = value.get(("rotor_inertia", name), {"inertia": 0.0})["inertia"]
        joint.solref_friction, joint.solimp_friction = [2 * STEP, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
        drive = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0], drive.biastype = k, mujoco.mjtBias.mjBIAS_AFFINE
        # A reading that has an offset is a drive that gives so much less.
        drive.biasprm[0] = -value.get(("torque_offset", name), {"torque": 0.0})["torque"]
        drive.biasprm[1:3] = {"position": (-k, -d), "velocity": (0.0, -k), "torque": (0.0, 0.0)}[drives.law]
        if np.isfinite(most):
            drive.forcelimited, drive.forcerange = True, [-most + drive.biasprm[0], most + drive.biasprm[0]]
        body = next(b for b in spec.bodies if any(j.name == name for j in b.joints))
        play = value.get(("backlash", name))
        if play is not None or (spring is not None and spring[0] == name):
            gap = body.add_joint(name=f"{name}_gap", type=joint.type, axis=joint.axis, armature=1e-3 * k * STEP)
            if play is not None:
                gap.range, gap.limited = [-play["play"], play["play"]], mujoco.mjtLimited.mjLIMITED_TRUE
                gap.solref_limit, gap.solimp_limit = [2 * STEP, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
                joint.armature = max(float(joint.armature), 1e-2 * k * 0.01)
            else:
                assert spring is not None
                gap.stiffness, gap.damping = (np.array([share * spring[1], 0, 0]) for share in (1.0, 1e-3))
        if ("payload", name) in value:
            load = value["payload", name]
            held = body.add_body(name="load", pos=[load[axis] for axis in "xyz"], explicitinertial=True)
            held.mass, held.inertia, held.ipos = load["mass"], [1e-9] * 3, [0.0, 0.0, 0.0]
    return spec.compile()


def _recorded(
    exact: str, joints: tuple[str, ...], path: Path, drives: _Drives, hidden: tuple[Hidden, ...],
    spring: tuple[str, float] | None, told: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(n, nj) positions and commands at the samples; the commands `told` or, without any, those that the path needs."""
    model = _plant(exact, joints, hidden, spring, drives)
    data, names = mujoco.MjData(model), [model.joint(i).name for i in range(model.njnt)]
    dof = [names.index(joint) for joint in joints]
    gaps = [(j, names.index(f"{joint}_gap")) for j, joint in enumerate(joints) if f"{joint}_gap" in names]
    played = [g for j, g in gaps if model.jnt_limited[g]]
    count = round(path.seconds / STEP / drives.every)
    ways = [part[:, :JOINTS] for part in path.at(STEP * drives.every * np.arange(count))]
    data.qpos[dof] = ways[0][0]
    bare_model = compiled(exact, joints)
    plan, mass = mujoco.MjData(bare_model), np.zeros((bare_model.nv, bare_model.nv))
    q, commands, at_limit = np.empty((count, JOINTS)), np.empty((count, JOINTS)), 0
    gains, biases = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    limits, offsets = model.actuator_forcerange.copy(), biases[:, :1].copy()
    w = 2 * np.pi * OUTSIDE
    for k in range(count):
        q[k] = data.qpos[dof]
        for j, gap in gaps:
            q[k, j] += data.qpos[gap] if gap in played else 0.0  # a spring's drive reads itself
        if told is not None:
            commands[k] = told[k]
        elif drives.law == "position":
            commands[k] = ways[0][k]
        elif drives.law == "velocity":
            commands[k] = ways[1][k] + w * (ways[0][k] - q[k])
        else:
            plan.qpos[:], plan.qvel[:] = q[k], data.qvel[dof]
            mujoco.mj_forward(bare_model, plan)
            mujoco.mj_fullM(bare_model, plan, mass)
            wanted = ways[2][k] + w**2 * (ways[0][k] - q[k]) + 1.6 * w * (ways[1][k] - data.qvel[dof])
            commands[k] = (mass @ wanted + plan.qfrc_bias) / drives.gain
        share = float(_supply(drives, np.array([k * drives.every * STEP]))[0]) if np.isfinite(drives.period) else 1.0
        model.actuator_gainprm[:], model.actuator_biasprm[:] = share * gains, share * biases
        model.actuator_biasprm[:, :1] = offsets
        model.actuator_forcerange[:] = share * (limits - offsets) + offsets
        for step in range(drives.every):
            late = (k * drives.every + step - drives.late) // drives.every
            data.ctrl[:] = commands[max(late, 0)]
            mujoco.mj_step(model, data)
        if np.isfinite(drives.limit).any():
            at_limit += np.any(np.abs(data.actuator_force) >= 0.999 * np.abs(model.actuator_forcerange).min(axis=1))
    if not np.all(np.isfinite(q)) or at_limit > HELPLESS * count or np.abs(q - ways[0]).max() > 1.5:
        raise FloatingPointError("the drives cannot hold the arm on its path")
    return q, commands
