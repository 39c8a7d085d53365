"""Robots generated with hidden effects do what the catalogue says, and hide nothing that does not show."""

from dataclasses import replace

import numpy as np
import pytest
from worlds.drive import SMALL, Hidden, Lump, on_link
from worlds.generated_arm import generate, showing
from worlds.plant import perfect

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.study import Study

JOINT = "panda_joint4"


VALUES = {
    "joint_viscous_friction": {"coefficient": 2.0},
    "joint_coulomb_friction": {"torque": 2.0},
    "joint_asymmetric_friction": {"positive": 2.0, "negative": 1.0},
    "joint_stribeck_friction": {"torque": 2.0, "speed": 0.3},
    "joint_load_friction": {"coefficient": 0.1},
    "rotor_inertia": {"inertia": 0.5},
    "torque_offset": {"torque": -1.0},
    "torque_gain": {"error": 0.1},
    "torque_delay": {"time": 0.03},
    "gravity_spring": {"sine": 3.0, "cosine": -2.0},
    "joint_spring": {"stiffness": 3.0, "rest": -1.0},
}
HIDDEN = {effect: Hidden(effect, JOINT, values) for effect, values in VALUES.items()}
HIDDEN["payload"] = on_link("payload", "panda_joint7", Lump(1.5, (0.02, -0.03, 0.1)))


@pytest.mark.parametrize("effect", HIDDEN)
def test_hidden_values_are_those_of_the_model_that_predicts_the_recording(effect: str) -> None:
    hidden = HIDDEN[effect]
    world = perfect("panda", "multisine", 3, duration=12.0, rate=250.0)
    run = world.recorded([hidden], np.zeros((3, len(world.stamps), len(world.plant.joints))), effect)
    given = arm_model(robot="panda")
    values = {f"{effect}.{short}[{hidden.joint}]": value for short, value in hidden.values.items()}
    told = given.with_effect(CATALOGUE[effect].on(hidden.joint)).with_values(values)
    errors = {}
    for name, model in (("given", given), ("told", told)):
        ready = model.prepare_run(run)
        found = model.predict(ready, model.theta())
        rows = found.slices[f"tau.{JOINT}"]
        errors[name] = np.sqrt(np.mean((ready.channels[f"tau.{JOINT}"].value - found.values[rows]) ** 2))
    assert errors["told"] < 0.05 * errors["given"]


def test_every_effect_of_the_generator_is_looked_at() -> None:
    assert HIDDEN.keys() == SMALL.keys() | {"payload"}


def test_what_others_do_as_well_does_not_show() -> None:
    world = perfect("panda", "multisine", 3, duration=12.0)
    world = replace(world, drive=replace(world.drive, noise=np.full(7, 0.05)))
    asymmetric, offset = HIDDEN["joint_asymmetric_friction"], HIDDEN["torque_offset"]
    assert len(showing([world], [asymmetric, offset])) == 1
    assert showing([world], [asymmetric, HIDDEN["payload"]]) == (asymmetric, HIDDEN["payload"])
    assert showing([world], [Hidden("rotor_inertia", JOINT, {"inertia": 1e-5})]) == ()


@pytest.mark.parametrize(("rate", "count"), [(100.0, 1), (500.0, 6), pytest.param(100.0, 6, marks=pytest.mark.slow)])
def test_a_creeping_wrist_behind_a_low_pass_is_told_whole(rate: float, count: int) -> None:
    # A gain and a friction that grows with the load hide each other; a fading friction hides behind an asymmetric one.
    robot = generate(2, story=True)
    catalogue = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")
    mended = repair(Study.of(arm_model(robot.name), robot.cut(rate, 12.0, count).runs(), (), catalogue))
    found = {(effect.effect, joint) for effect in mended.steps[-1].effects for joint in effect.joints}
    assert found == {(hidden.effect, hidden.joint) for hidden in robot.truth}
