"""Robots generated with hidden effects do what the catalogue says, and hide nothing that does not show."""

from dataclasses import replace

import numpy as np
import pytest
from worlds.drive import Hidden, Lump, on_link
from worlds.generated_arm import generate, showing
from worlds.plant import perfect

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.study import Study

JOINT = "panda_joint4"


def test_what_others_do_as_well_does_not_show() -> None:
    world = perfect("panda", "multisine", 3, duration=12.0)
    world = replace(world, drive=replace(world.drive, noise=np.full(7, 0.05)))
    asymmetric = Hidden("joint_asymmetric_friction", JOINT, {"positive": 2.0, "negative": 1.0})
    payload = on_link("payload", "panda_joint7", Lump(1.5, (0.02, -0.03, 0.1)))
    assert len(showing([world], [asymmetric, Hidden("torque_offset", JOINT, {"torque": -1.0})])) == 1
    assert showing([world], [asymmetric, payload]) == (asymmetric, payload)
    assert showing([world], [Hidden("rotor_inertia", JOINT, {"inertia": 1e-5})]) == ()


@pytest.mark.parametrize(
    ("rate", "count"), [(100.0, 1), *(pytest.param(r, 6, marks=pytest.mark.slow) for r in (100.0, 500.0))]
)
def test_a_creeping_wrist_behind_a_low_pass_is_told_whole(rate: float, count: int) -> None:
    # A gain and a friction that grows with the load hide each other; a fading friction hides behind an asymmetric one.
    robot = generate(2, story=True)
    catalogue = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")
    mended = repair(Study.of(arm_model(robot.name), robot.cut(rate, 12.0, count).runs(), (), catalogue))
    found = {(effect.effect, joint) for effect in mended.steps[-1].effects for joint in effect.joints}
    assert found == {(hidden.effect, hidden.joint) for hidden in robot.truth}
