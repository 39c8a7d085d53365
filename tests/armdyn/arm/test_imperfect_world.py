"""The generator of imperfect robots, held against other physics; tests of the search on it are elsewhere."""

import numpy as np
import pinocchio as pin
import pytest
from worlds.drive import COUNT, Lump, on_link
from worlds.imperfect_arm import CASES, ROBOTS, generate
from worlds.motions import KINDS
from worlds.plant import Plant, perfect

import urdf
from armdyn.effects.catalogue import CATALOGUE


def rnea(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_lump_adds_the_torque_of_a_body_on_its_link(robot):
    lump = Lump(0.7, (0.03, -0.05, 0.11), 0.002)
    world, model = perfect(robot, "multisine", seed=2, duration=1.0), urdf.load(robot).model.copy()
    joint = len(world.plant.joints) - 2
    motion = world.motion.at(world.stamps)
    model.inertias[joint + 1] += pin.Inertia(lump.mass, np.array(lump.place), lump.inertia * np.eye(3))
    found = world.load((on_link("link_inertia", world.plant.joints[joint], lump),))
    assert found == pytest.approx(rnea(model, *motion), abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(kind):
    plant, step = Plant("panda"), 1e-4
    rng = np.random.default_rng(3)
    room = plant.rooms(rng)[1]
    motion = KINDS[kind](rng, room, 20.0)
    time = np.linspace(0.5, 19.5, 777)
    q, v, a = motion.at(time)
    before, after = motion.at(time - step), motion.at(time + step)
    assert (after[0] - before[0]) / (2.0 * step) == pytest.approx(v, abs=1e-4)
    assert (after[1] - before[1]) / (2.0 * step) == pytest.approx(a, abs=1e-2)
    assert np.all(q >= plant.lower)
    assert np.all(q <= plant.upper)
    assert np.all(np.abs(v) <= 1.01 * room.speed)


def test_a_seed_decides_everything():
    first, again, other = (generate("ur5", "coulomb", seed, duration=5.0) for seed in (1, 1, 2))
    assert first.truth == again.truth != other.truth
    for run, same in zip(first.train + first.exam, again.train + again.exam, strict=True):
        assert all(np.array_equal(run.channels[n].value, same.channels[n].value) for n in run.channels)


def test_every_dominant_effect_is_known_by_name_and_size():
    assert set(COUNT) >= {effect for effects in CASES.values() for effect in effects}
    assert all(count == len(CATALOGUE[effect].quantities) for effect, count in COUNT.items())
