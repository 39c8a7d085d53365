"""What is compared of a recorded torque, and how noisy it is."""

from dataclasses import replace

import numpy as np
import pytest
from worlds.drive import Hidden, Lump, on_link
from worlds.plant import perfect

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE

JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
HEAVY = {
    "rotor_inertia": Hidden("rotor_inertia", "panda_joint4", {"inertia": 5.0}),
    "payload": on_link("payload", "panda_joint7", Lump(8.0, (0.02, -0.03, 0.1))),
}


@pytest.mark.parametrize("effect", HEAVY)
def test_what_is_heavier_than_described_makes_more_noise_of_the_positions(effect: str) -> None:
    hidden = HEAVY[effect]
    world = perfect("panda", "multisine", 3, duration=30.0, rate=250.0)
    world = replace(world, drive=replace(world.drive, position_noise=3e-4, noise=np.full(len(JOINTS), 1e-4)))
    noise = np.random.default_rng(0).standard_normal((3, len(world.stamps), len(JOINTS)))
    values = {f"{effect}.{short}[{hidden.joint}]": value for short, value in hidden.values.items()}
    model = arm_model(robot="panda").with_effect(CATALOGUE[effect].on(hidden.joint)).with_values(values)
    ready = model.prepare_run(world.recorded([hidden], noise, effect))
    found, there = model.predict(ready, model.theta()), model.noise(ready, model.theta())
    left = {c: ready.channels[c].value - found.values[rows] for c, rows in found.slices.items()}
    described, known = (np.array([np.mean((r / std[c]) ** 2) for c, r in left.items()]) for std in (ready.noise, there))
    most = described.argmax()
    assert described[most] > 5.0
    assert 0.5 < known[most] < 1.5
    assert known.max() < 1.5
