"""Arms simulated in MuJoCo, held against Pinocchio and their own seeds."""

from functools import lru_cache
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from worlds import mujoco_arm
from worlds.mujoco_arm import CORRELATION, ENCODER, ROBOTS, SimulatedArm, compiled
from worlds.mujoco_plant import LINK_ERROR, Path

SECONDS = (6.0, 4.5, 4.5, 4.5)
CLOSE = 1e-3
"""Of the largest torque: MuJoCo takes friction at the speed of half a step earlier or later."""


@lru_cache
def arm(seed: int, kind: str = "ordinary") -> SimulatedArm:
    return mujoco_arm.generate(seed, kind, seconds=SECONDS)


def hidden(arm: SimulatedArm, effect: str, short: str) -> np.ndarray:
    """(nj,) values of an effect, 0 where it is not."""
    values = {one.joint: one.values[short] for one in arm.hidden if one.effect == effect}
    return np.array([values.get(joint, 0.0) for joint in arm.joints])


@pytest.mark.parametrize(("seed", "kind"), [(2, "ordinary"), (3, "ordinary"), (0, "unknown")])
def test_torques_are_those_of_rigid_bodies_with_what_is_hidden(seed, kind):
    one = arm(seed, kind)
    model = pin.buildModelFromXML(one.exact)
    assert tuple(model.names)[1:] == one.joints
    assert [h.effect for h in one.hidden if h.effect == "payload"] == (["payload"] if kind == "ordinary" else [])
    for load in (h.values for h in one.hidden if h.effect == "payload"):
        place = np.array([load[axis] for axis in "xyz"])
        model.inertias[model.njoints - 1] += pin.Inertia(load["mass"], place, np.zeros((3, 3)))
    data = model.createData()
    for log in one.logs[:2]:
        found = np.array([pin.rnea(model, data, *row) for row in zip(log.q, log.v, log.a, strict=True)])
        found += hidden(one, "joint_viscous_friction", "coefficient") * log.v
        found += hidden(one, "rotor_inertia", "inertia") * log.a + log.friction + log.unknown
        assert found == pytest.approx(log.torque, abs=CLOSE * np.abs(log.torque).max())
        largest, moving = hidden(one, "joint_coulomb_friction", "torque"), np.abs(log.v) > 0.1
        assert np.all(np.abs(log.friction) <= 1.001 * largest)
        assert log.friction[moving] == pytest.approx((largest * np.sign(log.v))[moving], rel=1e-3)
    assert (np.abs(np.vstack([log.unknown for log in one.logs])).max(axis=0) > 0).sum() == (kind == "unknown")


def test_a_seed_decides_everything():
    first, again, other = (mujoco_arm.generate(seed, "ar1", seconds=SECONDS) for seed in (1, 1, 7))
    assert first.hidden == again.hidden != other.hidden
    for run, same in zip(first.runs, again.runs, strict=True):
        assert all(np.array_equal(run.channels[n].value, same.channels[n].value) for n in run.channels)


def test_only_a_description_that_is_off_is_off_and_by_5_to_10_per_cent():
    masses = []
    for one in (arm(3), arm(2)):
        assert one.off == (one is arm(3))
        roots = [ET.fromstring(text) for text in (one.exact, one.description)]
        masses.append([[float(mass.get("value", 0)) for mass in root.iter("mass")] for root in roots])
    ratio = np.array([given / exact for exact, given in zip(*masses[0], strict=True) if exact > 0])
    assert np.all((np.abs(ratio - 1) >= LINK_ERROR[0] - 1e-6) & (np.abs(ratio - 1) <= LINK_ERROR[1] + 1e-6))
    assert masses[1][0] == masses[1][1]


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_moves_from_rest_to_rest_within_its_limits(robot):
    described, step = mujoco_arm.robot_of(robot), 1e-4
    path = Path.drawn(np.random.default_rng(5), described, mujoco_arm.SLOW, 20.0)
    time = np.linspace(0.01, 19.99, 777)
    (q, v, a), before, after = path.at(time), path.at(time - step), path.at(time + step)
    assert (after[0] - before[0]) / (2 * step) == pytest.approx(v, abs=1e-5)
    assert (after[1] - before[1]) / (2 * step) == pytest.approx(a, abs=1e-3)
    assert np.all((q > described.limits.lower) & (q < described.limits.upper))
    assert np.abs(path.at(np.array([0.0, 20.0]))[1]).max() == 0.0
    model = compiled(ET.tostring(mujoco_arm.bare(described.urdf_xml, described.joint_names), "unicode"),
                     described.joint_names)  # fmt: skip
    assert model.nv == len(described.joint_names)


def test_readings_have_the_noise_of_their_kind():
    coloured, rough = arm(1, "ar1"), arm(0, "quantised")
    for j, joint in enumerate(coloured.joints):
        offset = hidden(coloured, "torque_offset", "torque")[j]
        noise = coloured.runs[0].channels[f"tau.{joint}"].value - coloured.logs[0].torque[:, j] - offset
        assert np.std(noise) == pytest.approx(coloured.noise[j], rel=0.2)
        assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(CORRELATION, abs=0.15)
    assert rough.resolution in ENCODER
    for joint in rough.joints:
        steps = rough.runs[0].channels[f"q.{joint}"].value / rough.resolution
        assert steps == pytest.approx(np.round(steps), abs=1e-6)
