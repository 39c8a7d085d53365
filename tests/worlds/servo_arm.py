"""Arms that record what their drives were told and where their joints went, with effects that are drawn from a seed.

The first five joints of four robots, their drives of two kinds: those of the joints that carry most, and those of the
others. All have one law in an arm; a kind has one gain, which the model knows within 10 % or not at all. They are told
something new 50 or 100 times a second, which acts late by a delay that nobody knows; supplies sag, drives saturate.
Arms that are told velocities or torques are kept on their paths by a loop outside. The truth moves in steps of half a
millisecond by `armdyn.arm.closed_loop.simulator`, which MuJoCo and Pinocchio check elsewhere; encoders read in steps.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pinocchio as pin

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.closed_loop.simulator import DriveInputs, simulate_arm
from armdyn.arm.control_laws import CONTROL_LAWS, DriveSignals
from armdyn.arm.model import ArmModel, arm_model
from armdyn.arm.motion import Motion
from armdyn.arm.rigid import inverse_dynamics
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.run import Run
from urdf import known_robots

from . import squares_left
from .generated_arm import ROBOTS
from .motions import KINDS
from .plant import Plant, source

JOINTS = 5
LAWS = ("position", "position", "velocity", "torque")  # each as likely: most such arms are told positions
STEP = 5e-4  # s of the truth's simulation
RATES = (50.0, 100.0)  # commands and samples a second
TURN = (4096, 16384, 65536)  # steps of an encoder in a turn
SECONDS, RUNS = 20.0, 3  # of a run; runs, the last held out
BEFORE = 2.0  # s that an arm moves before it records
SLOW = 0.6  # of the speed of arms with torque sensors
DROOP = {"position": (0.04, 0.12), "velocity": (0.1, 0.3), "torque": (0.8, 1.25)}
"""Error by which a drive carries the largest load of its kind, rad and rad/s; the gain of one that is told torques."""
DAMPED = (0.3, 0.7)  # damping ratio of a position servo by viscous friction: without any, no such servo comes to rest
DELAY, SAG, LIMIT = (0.0, 0.03), 0.15, (0.9, 1.1)
"""s; largest share that a supply loses; limit over the largest load of the kind."""
SHARE = (0.05, 0.25)
"""Friction, offset and a rotor's torque over the largest load of the joint, of which a joint has at least LEAST."""
LEAST = 0.15  # of its kind's
PER_LOAD, FADING, CARRIED = (0.05, 0.2), (0.05, 0.2), (0.02, 0.08)
"""Load friction; rad/s of Stribeck's; payload over the arm's mass."""
EFFECTS = (
    "joint_viscous_friction", "joint_coulomb_friction", "joint_stribeck_friction", "joint_load_friction",
    "rotor_inertia", "torque_offset", "payload",
)  # fmt: skip
OUTSIDE = 1.2  # Hz of the loop around drives that are told velocities or torques
HELPLESS = 0.5  # of the time: a drive that is at its limit for longer does not keep its arm on its path
SHOWN, BAND, STILL, THINNED = 50.0, 6.0, 0.02, 10
"""Nats, see `generated_arm.SHOWN`; Hz to which positions' noise becomes torque; rad/s; independent samples a second."""


@dataclass(frozen=True)
class ServoArm:
    """One arm."""

    seed: int  # of everything random
    robot: str  # its name
    law: str  # of its drives
    known: ArmModel  # what its user has: the description, and tables of its drives
    truth: ArmModel  # with what is hidden; its drives have their gains and delays
    runs: tuple[Run, ...]  # recordings, the last is held out


@lru_cache(maxsize=8)
def _described(robot: str) -> tuple[Plant, ArmModel]:
    name = source(robot)
    plant = Plant(name)
    own = {"robot": name} if robot in known_robots() else {"urdf": name}
    return plant, arm_model(**own, joints=plant.joints[:JOINTS])


def generate(seed: int, effects: tuple[str, ...] = EFFECTS) -> ServoArm:
    """One arm with some of these effects; kinds of robots and laws follow the seed in turn.

    Where nothing shows what is hidden, or a loop does not keep its arm on its path, another one is drawn.
    """
    rng = np.random.default_rng([seed, 43])
    robot, law = ROBOTS[seed % len(ROBOTS)], LAWS[seed // len(ROBOTS) % len(LAWS)]
    plant, arm = _described(robot)
    rate = float(rng.choice(RATES))
    rooms = [replace(r, speed=SLOW * r.speed, acceleration=SLOW**2 * r.acceleration) for r in plant.rooms(rng)]
    kinds = [list(KINDS)[k] for k in rng.permutation(len(KINDS))]
    paths = [KINDS[kind](rng, rooms[k % len(rooms)], SECONDS) for k, kind in enumerate(kinds[:RUNS])]
    time = np.arange(-round(BEFORE * rate), round(SECONDS * rate)) / rate
    ways = [tuple(part[:, :JOINTS] for part in path.at(time)) for path in paths]
    load = np.max([np.abs(inverse_dynamics(arm.arm.model, q, 0 * v, 0 * a)).max(axis=0) for q, v, a in ways], axis=0)
    strong = load > 0.3 * load.max()
    tables, true_tables, largest = {}, {}, np.zeros(JOINTS)
    sags, limited = bool(rng.random() < 0.4), bool(rng.random() < 0.4)
    delay, saturation = STEP * round(rng.uniform(*DELAY) / STEP), rng.uniform(*LIMIT)
    for kind, members in (("shoulder", strong), ("wrist", ~strong)):
        joints = [joint for joint, own in zip(arm.joints, members, strict=True) if own]
        peak = float(load[members].max())
        largest[members] = np.maximum(load[members], LEAST * peak)
        droop = rng.uniform(*DROOP[law])
        gain = droop if law == "torque" else peak / droop
        unit = {"position": "N m/rad", "velocity": "N m s/rad", "torque": "1"}[law]
        # The wrist's gain is known: hardly any weight shows it.
        told = f"{gain * rng.normal(1.0, 0.05):.6g} {unit} +/- 5 %" if kind == "wrist" else None
        table: dict[str, Any] = {"joints": joints, "law": law}
        table |= {"supply": "12 V"} if sags else {}
        table |= {"limit": f"{1.5 * saturation * peak:.6g} N m"} if limited else {}
        tables[kind] = table | ({"gain": told} if told else {})
        true_tables[kind] = table | {"gain": f"{gain:.10g} {unit}", "delay": f"{delay:.10g} s"}
    truth = _hidden(rng, arm.with_drives(true_tables), ways, largest, effects)
    encoder = 2.0 * np.pi / float(rng.choice(TURN))
    records = []
    for k, way in enumerate(ways):
        volts = 12.0 * (1.0 - SAG * np.abs(np.sin(2 * np.pi * time / rng.uniform(3.0, 9.0)))) if sags else None
        records.append(
            partial(_recorded, law=law, time=time, way=way, delay=delay, volts=volts, encoder=encoder, name=f"run {k}")
        )
    try:
        truth = _showing(truth, [record(truth)[1] for record in records[:-1]], law, encoder)
        runs = [record(truth)[0] for record in records]
    except InputError:  # carried off
        truth = truth.with_only_effects(())
    if not truth.effects:
        return generate(seed + 1_000_000, effects)
    return ServoArm(seed, robot, law, arm.with_drives(tables), truth, tuple(runs))


def _hidden(
    rng: np.random.Generator, arm: ArmModel, ways: list, largest: np.ndarray, effects: tuple[str, ...]
) -> ArmModel:
    """The arm with some effects on all its joints, in sizes that follow their loads."""
    speed, acceleration = (np.sqrt(np.mean(np.vstack([w[k] for w in ways]) ** 2, axis=0)) for k in (1, 2))
    inertia = np.diag(pin.crba(arm.arm.model, arm.arm.model.createData(), ways[0][0].mean(axis=0)))
    chosen = set(rng.choice(effects, int(rng.integers(1, 5)), replace=False).tolist())
    position = next(iter(arm.drives.values())).law == "position"
    chosen |= {"joint_viscous_friction"} if position else set()
    values: dict[str, float] = {}
    for effect in [name for name in EFFECTS if name in chosen]:
        arm = arm.with_effect(CATALOGUE[effect])
        if effect == "payload":
            mass = sum(link.mass for link in arm.arm.model.inertias) * rng.uniform(*CARRIED)
            place = dict(zip("xyz", rng.uniform(-0.05, 0.05, 3).tolist(), strict=True))
            values |= {f"payload.{k}[{arm.joints[-1]}]": v for k, v in {"mass": mass, **place}.items()}
            continue
        for j, joint in enumerate(arm.joints):
            size = float(largest[j] * rng.uniform(*SHARE))
            servo = next(servo for servo in arm.drives.values() if joint in servo.joints)
            assert servo.gain is not None
            of = {
                "joint_viscous_friction": {"coefficient": size / speed[j]},
                "joint_coulomb_friction": {"torque": size},
                "joint_stribeck_friction": {"torque": size, "speed": rng.uniform(*FADING)},
                "joint_load_friction": {"coefficient": rng.uniform(*PER_LOAD)},
                "rotor_inertia": {"inertia": size / acceleration[j]},
                "torque_offset": {"torque": size * rng.choice([-1.0, 1.0])},
            }[effect]
            if position and effect == "joint_viscous_friction":
                of = {"coefficient": 2.0 * rng.uniform(*DAMPED) * float(np.sqrt(servo.gain.value * inertia[j]))}
            values |= {f"{effect}.{short}[{joint}]": float(value) for short, value in of.items()}
    return arm.with_values(values)


def _recorded(
    truth: ArmModel, law: str, time: np.ndarray, way: tuple, delay: float, volts: np.ndarray | None, encoder: float,
    name: str,
) -> tuple[Run, Motion]:  # fmt: skip
    """What the arm records on its way, and its exact motion."""
    q_ref, v_ref, a_ref = way
    model, theta = truth.rigid_body_model_at(truth.theta()), truth.theta()
    data, each, h = model.createData(), round((time[1] - time[0]) / STEP), STEP
    servos = [next(s for s in truth.drives.values() if joint in s.joints) for joint in truth.joints]
    gain = np.array([servo.gain.value for servo in servos if servo.gain is not None])
    limit = np.array([servo.limit for servo in servos])
    q, v = q_ref[0].copy(), np.zeros(JOINTS)
    told, states = np.zeros((len(time), JOINTS)), []
    zeros = np.zeros((each, JOINTS))
    for k in range(len(time)):
        w = 2.0 * np.pi * OUTSIDE
        if law == "position":
            told[k] = q_ref[k]
        elif law == "velocity":
            told[k] = v_ref[k] + w * (q_ref[k] - q)
        else:
            wanted = a_ref[k] + w**2 * (q_ref[k] - q) + 1.6 * w * (v_ref[k] - v)
            told[k] = pin.rnea(model, data, q, v, wanted) / gain
        act = np.clip(np.floor((k * each + np.arange(each)) / each - delay / (h * each) + 1e-9).astype(int), 0, k)
        command = told[act]
        share = np.ones((each, JOINTS))
        if volts is not None:
            share *= np.interp(time[k] + h * (np.arange(each) + 0.5), time, volts)[:, None] / 12.0
        most = np.tile(limit, (each, 1))
        told_to = DriveSignals(zeros, command, zeros, most, share, zeros + gain, zeros)
        drives = DriveInputs(told_to, (CONTROL_LAWS[law],) * JOINTS, zeros)
        states.append((q, v))
        found_q, found_v = simulate_arm(truth, theta, (q, v), drives, h)
        q, v = found_q[-1], found_v[-1]
    q_all, v_all = np.array(states).transpose(1, 0, 2)
    asked = gain * {"position": told - q_all, "velocity": told - v_all, "torque": told}[law]
    if np.any(np.mean(np.abs(asked) >= limit, axis=0) > HELPLESS):
        raise InputError("the drives cannot hold the arm on its path")
    rows = time >= -1e-9
    exact, told, time = np.array(states)[rows].transpose(1, 0, 2), told[rows], time[rows]
    volts = None if volts is None else volts[rows]
    columns: dict[str, np.ndarray] = {}
    channel = {"position": "q_cmd", "velocity": "v_cmd", "torque": "tau_ff"}[law]
    for j, joint in enumerate(truth.joints):
        columns[f"q.{joint}"] = np.round(exact[0][:, j] / encoder) * encoder
        columns[f"{channel}.{joint}"] = told[:, j]
        if volts is not None:
            columns[f"voltage.{joint}"] = volts
    acceleration = np.gradient(exact[1], time, axis=0)
    motion = Motion(time, exact[0], exact[1], acceleration, np.sign(exact[1]))
    return Run.from_arrays(time, columns, name=name, joints=None), motion


def _showing(truth: ArmModel, motions: list[Motion], law: str, encoder: float) -> ArmModel:
    """The arm with those of its effects that its motions can show, on the joints where they can.

    As `generated_arm.showing`, by exact derivatives at the truth; the noise is the encoder's in what the drive reads,
    and what it becomes through inertia.
    """
    motion = Motion(*(np.concatenate([getattr(m, k) for m in motions]) for k in ("time", "q", "v", "a", "direction")))
    thin = max(1, round(1.0 / (THINNED * (motion.time[1] - motion.time[0]))))
    motion = Motion(*(getattr(motion, k)[::thin] for k in ("time", "q", "v", "a", "direction")))
    whole = truth.with_fixed_null_effects(CATALOGUE[name] for name in (*EFFECTS, "joint_asymmetric_friction"))
    _, slopes = whole.at_states(MotionSamples(truth.arm.model, motion, motion.time))
    inertia = np.diag(pin.crba(truth.arm.model, truth.arm.model.createData(), motion.q.mean(axis=0)))
    moving = np.abs(motion.v) > STILL
    kept = truth
    while True:
        nats = {}
        for effect in kept.effects:
            for joint, names in kept.parameter_names_by_joint(effect.name).items():
                j = truth.joints.index(joint)
                servo = next(s for s in truth.drives.values() if joint in s.joints)
                assert servo.gain is not None
                angular = 2.0 * np.pi * BAND
                own = {"position": 1.0, "velocity": angular, "torque": 0.0}[law] * (
                    servo.gain.value if law != "torque" else 0.0
                )
                noise = encoder / np.sqrt(12.0) * float(np.hypot(own, inertia[j] * angular**2))
                use = moving[:, j]
                column = {n: slopes[use, j, whole.names.index(n)] / noise for n in whole.names}
                rest = [n for n in kept.names if n not in names and (joint in n or n.startswith("payload"))]
                if effect.name in ("joint_stribeck_friction", "payload"):
                    first = names[0]
                    missing = column[first] * kept.value(first)
                else:
                    missing = sum(column[n] * kept.value(n) for n in names)
                there = {e.name for e in kept.effects if joint in kept.joints_having_effect(e.name)}
                others = [other for other in EFFECTS if other not in there]
                rivals = [[n for n in whole.names if n.startswith(f"{o}.") and joint in n] for o in others]
                places = [rest] + [rest + r for r in rivals if 0 < len(r) <= len(names)]
                nats[effect.name, joint] = min(
                    0.5 * squares_left([np.column_stack([column[n] for n in place])] if place else [], missing)
                    for place in places
                )
        if not nats:
            return kept
        weakest = min(nats, key=nats.__getitem__)
        if nats[weakest] > SHOWN:
            return kept
        kept = kept.without_effect(f"{weakest[0]}:{weakest[1]}")
