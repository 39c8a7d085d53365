"""Each effect of the arm's catalogue: a repair names it with its value, a clean arm gets none, and exports hold it.

Rigid bodies, damping, armature, springs, loads and mountings are MuJoCo's; the other torques are formulas in numpy.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from armdyn.arm.model import ArmModel, arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import CATALOGUE
from armdyn.run import Channel, Run
from pipeline.exports.mujoco_file import mujoco_text

JOINTS = ("turn", "swing", "elbow")
URDF = """<robot name="arm"><link name="base"/>
{}
</robot>"""
LINK = """<link name="{name}_link"><inertial><origin xyz="0.15 0.01 0.02"/><mass value="{mass}"/>
<inertia ixx="0.008" iyy="0.025" izz="0.02" ixy="0.001" ixz="0.0" iyz="-0.001"/></inertial></link>
<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{place}"/>
<axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" effort="60" velocity="4"/></joint>"""
TIME, NOISE, STDS, SLIDING = np.arange(0.0, 16.0, 0.02), 0.02, 4.0, 0.3
"""Stamps of a run, s; noise of torques, N m; deviations within which a value is the truth; rad/s of sure sliding."""
PLACE = (0.25, 0.05, -0.04)
"""Place of a load in the frame of the elbow, m."""
LEFT_OUT = {"joint_asymmetric_friction", "joint_load_friction", "torque_delay", "joint_coupling"}
"""Effects that MuJoCo's file does not hold, at least not whole."""
BY_BRISTLES = {"joint_stribeck_friction"}
"""Effects that MuJoCo computes from a motion, not at an instant; see test_servo_exports."""


class Moved(NamedTuple):
    """(n, 3) positions, velocities, accelerations, and torques of the bodies."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray


@dataclass(frozen=True)
class Hidden:
    """What is hidden of one effect.

    Attributes:
        values: true values by parameter.
        bodies: changes of MuJoCo's model.
        torque: further torque of the swing, (n,), or of all joints.
        load: mass at `PLACE` on the elbow's link, kg.
        delay: delay of the swing's torque sensor, s.
        also_known_as: other effects that are together the same, with their values.
        noise: standard deviation of the torques' noise, N m.
    """

    values: Mapping[str, float]
    bodies: Callable[[mujoco.MjModel], None] | None = None
    torque: Callable[[Moved], np.ndarray] | None = None
    load: float = 1e-9
    delay: float = 0.0
    also_known_as: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    noise: float = NOISE


def of_swing(name: str, value: float) -> Callable[[mujoco.MjModel], None]:
    return lambda model: getattr(model, name).__setitem__(1, value)


def heavier(model: mujoco.MjModel) -> None:
    body = model.body("elbow_link")
    body.mass[:] *= np.exp(0.3)
    body.inertia[:] *= np.exp(0.3)


def tilted(model: mujoco.MjModel) -> None:
    model.opt.gravity[:] = 9.81 * np.array([0.0, -np.sin(0.08), -np.cos(0.08)])


def spring(model: mujoco.MjModel) -> None:
    model.jnt_stiffness[1], model.qpos_spring[1] = 6.0, 0.4


def coupled(at: Moved) -> np.ndarray:
    found = np.zeros_like(at.q)
    found[:, 1:] = 0.9 * at.v[:, [2, 1]] + 0.08 * at.a[:, [2, 1]]
    return found


HIDDEN: Mapping[str, Hidden] = {
    "joint_viscous_friction": Hidden({"coefficient[swing]": 1.5}, of_swing("dof_damping", 1.5)),
    "joint_coulomb_friction": Hidden({"torque[swing]": 1.2}, torque=lambda at: 1.2 * np.sign(at.v[:, 1])),
    "joint_asymmetric_friction": Hidden(
        {"positive[swing]": 1.6, "negative[swing]": 0.5},
        torque=lambda at: np.where(at.v[:, 1] > 0, 1.6, -0.5),
        also_known_as={"joint_coulomb_friction": {"torque[swing]": 1.05}, "torque_offset": {"torque[swing]": 0.55}},
    ),
    "joint_stribeck_friction": Hidden(
        {"torque[swing]": 1.5, "speed[swing]": 0.2},
        torque=lambda at: 1.5 * np.sign(at.v[:, 1]) * np.exp(-((at.v[:, 1] / 0.2) ** 2)),
    ),
    "joint_load_friction": Hidden(
        {"coefficient[swing]": 0.15}, torque=lambda at: 0.15 * np.abs(at.load[:, 1]) * np.sign(at.v[:, 1])
    ),
    "rotor_inertia": Hidden({"inertia[swing]": 0.15}, of_swing("dof_armature", 0.15)),
    "torque_offset": Hidden({"torque[swing]": 0.8}, torque=lambda at: np.full(len(at.q), 0.8)),
    "torque_gain": Hidden({"error[swing]": 0.08}, torque=lambda at: 0.08 * at.load[:, 1]),
    "torque_delay": Hidden({"time[swing]": 0.02}, delay=0.02),
    "gravity_spring": Hidden(
        {"sine[swing]": 3.0, "cosine[swing]": 2.0},
        torque=lambda at: 3.0 * np.sin(at.q[:, 1]) + 2.0 * np.cos(at.q[:, 1]),
    ),
    "joint_spring": Hidden({"stiffness[swing]": 6.0, "rest[swing]": 0.4}, spring),
    "joint_coupling": Hidden({"viscous[elbow]": 0.9, "inertia[elbow]": 0.08}, torque=coupled),
    "payload": Hidden({"mass[elbow]": 0.6, "x[elbow]": 0.25, "y[elbow]": 0.05, "z[elbow]": -0.04}, load=0.6),
    "link_inertia": Hidden({"mass[elbow]": 0.3}, heavier),
    "base_tilt": Hidden({"roll": 0.08}, tilted),
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> ArmModel:
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(URDF.format("\n".join(
        LINK.format(name=n, parent=p, place=o, axis=x, mass=m) for n, p, o, x, m in zip(
            JOINTS, ("base", "turn_link", "swing_link"), ("0 0 0", "0 0 0.2", "0.3 0 0"), ("0 0 1", "0 1 0", "0 1 0"),
            (3, 2.5, 2), strict=True)
    )))  # fmt: skip
    return arm_model(file)


def moved(seed: int, delay: float = 0.0) -> tuple[np.ndarray, ...]:
    """(n, 3) positions, velocities and accelerations on smooth random paths from the seed, some time before `TIME`."""
    rng = np.random.default_rng(seed)
    w, phase = 2 * np.pi * rng.uniform(0.1, 0.6, (3, 4)), rng.uniform(0, 2 * np.pi, (3, 4))
    size, angle = rng.uniform(0.3, 0.6, (3, 4)) / (0.5 + w), w * (TIME - delay)[:, None, None] + phase
    return tuple((size * x).sum(2) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))


def recorded(arm: ArmModel, hidden: Hidden, seed: int) -> Run:
    """A run on smooth random paths from the seed."""
    spec = mujoco.MjSpec.from_string(arm.arm.robot.urdf_xml)
    body = spec.body("elbow_link").add_body(pos=PLACE, explicitinertial=True)
    body.mass, body.inertia, body.ipos = hidden.load, [1e-9] * 3, [0.0, 0.0, 0.0]
    spec.compiler.fusestatic = False
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model = spec.compile()
    if hidden.bodies is not None:
        hidden.bodies(model)
    q, v, a = moved(seed, hidden.delay)
    data, torque = mujoco.MjData(model), np.empty_like(q)
    for i in range(len(TIME)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse
    if hidden.torque is not None:
        more = hidden.torque(Moved(q, v, a, torque))
        torque += more if more.ndim > 1 else np.outer(more, [0.0, 1.0, 0.0])
    if hidden.delay:  # of one sensor
        present = recorded(arm, Hidden({}), seed)
        torque[:, [0, 2]] = np.column_stack([present.channels[f"tau.{j}"].value for j in ("turn", "elbow")])
        q = moved(seed)[0]
    rng, channels = np.random.default_rng([seed, 1]), {}
    for j, name in enumerate(JOINTS):
        channels[f"q.{name}"] = Channel(TIME, q[:, j] + 1e-5 * rng.standard_normal(len(TIME)), "rad")
        channels[f"tau.{name}"] = Channel(TIME, torque[:, j] + hidden.noise * rng.standard_normal(len(TIME)), "N m")
    return Run(f"{seed}.csv", channels)


def repaired(arm: ArmModel, hidden: Hidden) -> ArmModel:
    runs = [recorded(arm, hidden, seed) for seed in range(3)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = CheckedStudy.of(arm, runs[:2], runs[2:]).repair().model.capability(ArmModel)
    assert found is not None
    return found.without_background()


@pytest.fixture(scope="module")
def clean(arm) -> ArmModel:
    """What a repair makes of an arm that is as described."""
    return repaired(arm, Hidden({}))


@pytest.mark.parametrize("name", HIDDEN)
def test_it_is_named_with_its_value(arm, name):
    hidden = HIDDEN[name]
    model = repaired(arm, hidden)
    called, values = hidden.also_known_as or {name: hidden.values}, dict[str, float]()
    assert {effect.name for effect in model.effects} == set(called)
    values = {f"{effect}.{short}": true for effect, own in called.items() for short, true in own.items()}
    for full, true in values.items():
        p = model.parameters[full]
        assert p.std is not None
        assert abs(p.value - true) < STDS * p.std, full
    assert {p.joint for p in model.parameters.values() if p.effect} == {model.parameters[full].joint for full in values}


@pytest.mark.parametrize("name", HIDDEN)
def test_it_is_not_invented(clean, name):
    assert name not in {effect.name for effect in clean.effects}


@pytest.mark.parametrize("name", HIDDEN)
def test_mujocos_file_moves_as_it_does_or_says_why_not(arm, name):
    hidden = HIDDEN[name]
    model = arm.with_effect(CATALOGUE[name])
    model = model.with_values({f"{name}.{short}": value for short, value in hidden.values.items()})
    text, notes = mujoco_text(model)
    if any(note.startswith(name) for note in notes):
        assert name in LEFT_OUT
        return
    assert name not in LEFT_OUT
    if name in BY_BRISTLES:
        return
    run, compiled = recorded(arm, replace(hidden, noise=0.0), 5), mujoco.MjModel.from_xml_string(text)
    q, v, a = moved(5)
    data = mujoco.MjData(compiled)
    for i in np.flatnonzero(np.abs(v).min(axis=1) > SLIDING)[::40]:
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(compiled, data)
        data.ctrl[:] = [run.channels[f"tau.{joint}"].value[i] for joint in JOINTS]
        needed = data.qfrc_inverse.copy()
        mujoco.mj_fwdActuation(compiled, data)
        assert data.qfrc_actuator == pytest.approx(needed, abs=1e-6)
