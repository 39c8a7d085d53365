"""An arm's torques are those that MuJoCo itself has for its file, or the file is refused by the name of an element."""

import mujoco
import numpy as np
import pytest
from mjcf_variants import REFUSED, document, variants

from armdyn.arm.described import with_described_effects
from armdyn.arm.model import arm_model
from armdyn.arm.symbolic import inverse_dynamics_function
from armdyn.errors import InputError
from armdyn.model_file import ModelFile, write_model_file


def torques_of_mujoco(path, joints, q, v, a):
    """What the drives give by MuJoCo's inverse dynamics, where nothing touches and all other joints are at 0."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, found = mujoco.MjData(model), []
    for state in zip(q, v, a, strict=True):
        for j in range(model.njnt):
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE:
                data.qpos[model.jnt_qposadr[j]] = 0.0
        for joint, *numbers in zip(joints, *state, strict=True):
            data.joint(joint).qpos, data.joint(joint).qvel, data.joint(joint).qacc = numbers
        mujoco.mj_inverse(model, data)
        found.append([data.joint(joint).qfrc_inverse[0] for joint in joints])
    return np.array(found)


def assert_torques_alike(path, model):
    """At random states, to rounding."""
    q, v, a = np.random.default_rng(1).uniform(-1.5, 1.5, (3, 10, len(model.joints)))
    function = inverse_dynamics_function(model)
    ours = np.array([np.array(function(*state))[:, 0] for state in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(ours, torques_of_mujoco(path, model.joints, q, v, a), rtol=1e-9, atol=1e-9)


@pytest.fixture
def written(tmp_path):
    def write(**parts):
        path = tmp_path / "arm.xml"
        path.write_text(document(**parts))
        return path

    return write


def read(path, joints):
    return with_described_effects(arm_model(path, joints=joints))


@pytest.mark.parametrize("parts", [pytest.param(parts, id=name) for name, parts in variants().items()])
def test_torques_of_an_mjcf_are_those_of_mujoco(written, parts):
    path = written(**parts)
    assert_torques_alike(path, read(path, ("s", "e")))


def test_two_joints_in_one_body_are_two_of_the_arms(written):
    path = written(**variants()["two joints in a body"])
    assert_torques_alike(path, read(path, ("s", "e", "x")))


@pytest.mark.parametrize("parts", REFUSED.values(), ids=REFUSED)
def test_what_has_no_place_in_an_arms_model_is_refused_by_its_name(written, parts, complains):
    with complains(InputError):
        read(written(**parts), ("s", parts.get("name", "e")))


def test_dry_friction_of_an_mjcf_is_an_effect_of_the_joints_that_have_it(written):
    model = read(written(joint='frictionloss="0.7"'), ("s", "e"))
    assert [effect.label for effect in model.effects] == ["joint_coulomb_friction:e"]
    assert model.parameters["joint_coulomb_friction.torque[e]"].value == 0.7


def test_an_exported_arm_comes_back_with_all_its_effects(written, tmp_path, armdyn):
    path = written(
        joint='damping="2" armature=".3" frictionloss=".4" stiffness="3" springref=".2"',
        world='<option gravity="1 0 -9"/>',
        inside='<site name="b" pos=".1 .02 .1"/>',
        after='<tendon><spatial stiffness="50" springlength="0"><site site="a"/><site site="b"/></spatial></tendon>',
    )
    model = read(path, ("s", "e"))
    write_model_file(tmp_path / "m.toml", ModelFile(model, {"joints": ["s", "e"]}))
    assert armdyn("export", "m.toml", "--output", "again.xml")[0] == 0
    assert armdyn("new", "arm", "again.toml", "--mjcf", "again.xml")[0] == 0
    back = read(tmp_path / "again.xml", None)
    assert [effect.label for effect in back.effects] == [effect.label for effect in model.effects]
    for name, parameter in model.parameters.items():
        np.testing.assert_allclose(back.parameters[name].value, parameter.value, rtol=1e-9, atol=1e-12, err_msg=name)
    assert_torques_alike(path, back.without_effect("joint_coulomb_friction"))
