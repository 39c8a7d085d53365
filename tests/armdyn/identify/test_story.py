"""One strong effect of an arm comes first; after it the small ones of every joint, where they are all that is left."""

import numpy as np
from worlds.dominated_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.study import Study

JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")
SMALL = {"joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia", "link_inertia"}


def test_frictions_and_rotors_of_many_joints_are_told_after_the_payload_that_hides_them() -> None:
    case = generate("ur5", "payload", 6000, duration=12.0)
    found = repair(Study.of(arm_model(robot="ur5"), case.train, [], JOINT_EFFECTS, exam=[case.exam]))
    first, *later = [step for step in found.path[1:] if step.added != ("background",)]
    assert (first.added, first.joints) == (("payload",), ("wrist_3_joint",))
    assert {name for step in later for name in step.added} <= SMALL
    for name in ("joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia"):
        assert len({joint for step in later if name in step.added for joint in step.joints}) >= 4
    alone, all_told = (np.linalg.norm(list(step.exam_rmse.values())) for step in (first, later[-1]))
    assert all_told < 0.5 * alone
