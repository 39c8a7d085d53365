import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.scene import build_scene
from pipeline.robot.settings import PlantSettings, ServoSettings


@pytest.fixture(scope="module")
def model(baxter):
    """The plant with the arm's rotors left out, which the URDF does not know either."""
    settings = PlantSettings(servo=ServoSettings(armature=(0.0,) * 7, friction=(0.0,) * 7))
    return build_scene(baxter, settings, resolve_hidden({}), 0.08, np.ones(7))


@pytest.fixture(scope="module")
def postures(baxter):
    rng = np.random.default_rng(3)
    return rng.uniform(baxter.limits.lower, baxter.limits.upper, (50, 7))


def _at(model, q, v=None):
    data = mujoco.MjData(model)
    data.qpos[:7] = q
    if v is not None:
        data.qvel[:7] = v
    mujoco.mj_forward(model, data)
    return data


def test_mass_matrix_of_the_arm_equals_pinocchio(baxter, model, postures):
    for q in postures:
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, _at(model, q), full)
        expected = pin.crba(baxter.model, baxter.model.createData(), q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        np.testing.assert_allclose(full[:7, :7], expected, atol=1e-12)


def test_gravity_and_coriolis_torques_of_the_arm_equal_pinocchio(baxter, model, postures):
    rng = np.random.default_rng(4)
    for q in postures:
        v = rng.normal(size=7)
        expected = pin.rnea(baxter.model, baxter.model.createData(), q, v, np.zeros(7))
        np.testing.assert_allclose(_at(model, q, v).qfrc_bias[:7], expected, atol=1e-11)


def test_string_is_attached_where_pinocchio_puts_the_tool_point(model, baxter, postures):
    for q in postures:
        np.testing.assert_allclose(_at(model, q).site("pivot").xpos, baxter.tool_pose(q).translation, atol=1e-12)


def test_effort_limits_are_those_of_the_urdf(baxter, model):
    np.testing.assert_allclose(model.jnt_actfrcrange[:7, 1], baxter.limits.effort)


def test_box_stands_where_the_settings_say(baxter):
    settings = PlantSettings()
    model = build_scene(baxter, settings, resolve_hidden({}), 0.08, np.ones(7))
    near, far = model.geom("box_near"), model.geom("box_far")
    at_near, at_far = baxter.line.position(0.355), baxter.line.position(0.655)
    np.testing.assert_allclose(near.pos[:2], at_near[:2], atol=1e-12)
    np.testing.assert_allclose(far.pos[:2], at_far[:2], atol=1e-12)
    rim = near.pos[2] + near.size[2]
    assert rim == pytest.approx(at_near[2] - 0.285)
    floor = model.geom("box_floor")
    assert floor.pos[2] + floor.size[2] == pytest.approx(rim - 0.095)
