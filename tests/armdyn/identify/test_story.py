"""One strong effect of an arm comes first; after it the small ones of every joint, where they are all that is left."""

from hidden_effects.dominated_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.study import Study

JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")
SMALL = {"joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia", "link_inertia"}


def test_frictions_and_rotors_of_all_joints_are_told_after_the_payload_that_hides_them() -> None:
    case = generate("ur5", "payload", 5000, duration=12.0)
    model = arm_model(robot="ur5")
    found = repair(Study(model, case.train, [], JOINT_EFFECTS, exam=[case.exam]))
    first, *later = [step for step in found.path[1:] if step.added != ("background",)]
    assert (first.added, first.joints) == (("payload",), ("wrist_3_joint",))
    assert {name for step in later for name in step.added} <= SMALL
    for name in ("joint_coulomb_friction", "joint_viscous_friction"):
        assert {joint for step in later if name in step.added for joint in step.joints} == set(model.arm.joints)
    exam = {channel: error / found.after.channels[channel].noise_std for channel, error in later[-1].exam_rmse.items()}
    assert max(exam.values()) < 1.5
