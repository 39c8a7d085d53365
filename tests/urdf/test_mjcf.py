"""An MJCF as a robot: its torques are MuJoCo's, and what it does not say is told."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from urdf import UrdfError, load

ARM = """
<mujoco model="toy">
  <compiler angle="degree"/>
  <default><joint damping="0.5" armature="0.1" frictionloss="0.2"/><geom density="2000"/></default>
  <worldbody>
    <body name="base" pos="0 0 .3"><geom type="box" size=".1 .1 .1"/>
      <body name="upper" pos="0 .1 .1" euler="0 90 20">
        <joint name="swing" axis="0 0 1" pos="0.02 0 -0.01" range="-90 90" actuatorfrcrange="-30 30"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
        <body name="middle" pos="0 0.02 0">
        <joint name="tilt" axis="0 1 1" range="-60 60" pos="0 0.1 0"/><geom type="sphere" size=".05" pos=".1 0 0"/>
        <body name="lower" pos=".3 0 0">
          <joint name="turn" axis="1 1 0" range="-120 120"/>
          <inertial mass="1.3" pos=".1 0 .02" diaginertia=".01 .02 .015" quat=".9 .1 .3 .1"/>
          <body name="hand" pos=".3 0 0">
            <joint name="reach" type="slide" axis="0 1 0" range="0 0.2"/>
            <geom type="sphere" size=".04" pos="0 .02 .1"/><site name="tip" pos="0 0 .1"/>
            <body name="left"><joint name="finger_1" type="slide" axis="1 0 0" range="0 .04"/>
              <geom type="sphere" size=".01"/></body>
            <body name="right"><joint name="finger_2" type="slide" axis="-1 0 0" range="0 .04"/>
              <geom type="sphere" size=".01"/></body>
  </body></body></body></body></body></worldbody>
  <equality><joint joint1="finger_1" joint2="finger_2"/></equality>
  <actuator>
    <motor joint="turn" ctrlrange="-20 20" gear="2"/><position joint="reach" forcerange="-87 87"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "toy.xml"
    path.write_text(ARM)
    return path


def test_torques_are_those_of_mujoco(arm):
    robot = load(arm)
    assert robot.joint_names == ("swing", "tilt", "turn", "reach")
    model = mujoco.MjModel.from_xml_path(str(arm))
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(20):
        q, v, a = rng.uniform(-0.9, 0.9, (3, 4)) * [[1, 1, 1, 0.1], [2, 2, 2, 0.5], [5, 5, 5, 5]]
        q[3] += 0.1
        data.qpos[:], data.qvel[:], data.qacc[:] = (np.r_[x, 0.0, 0.0] for x in (q, v, a))
        mujoco.mj_inverse(model, data)
        own = pin.rnea(robot.model, robot.model.createData(), q, v, a)
        np.testing.assert_allclose(own, data.qfrc_inverse[:4], atol=1e-9)


def test_what_an_mjcf_does_not_say_is_assumed_and_told(arm):
    robot = load(arm)
    said = " | ".join(robot.notes)
    np.testing.assert_allclose(robot.model.effortLimit, [30.0, np.inf, 40.0, 87.0])
    assert "joint 'tilt' has no limit of effort" in said
    assert "it has no speed limits" in said
    assert "finger_1, finger_2 not part of the model" in said
    assert robot.tool_frame == "tip"
    assert load(arm, tool="hand").tool_frame == "hand"
    assert load(arm, joints=["reach", "finger_2"]).joint_names == ("reach", "finger_2")


@pytest.mark.parametrize(
    "change",
    [("<worldbody>", "<worldbdy>"), ('mass="1.3"', 'mass="heavy"'), ('"swing"', '"universe"'), (ARM, "<mujoco/>")],
)
def test_a_broken_mjcf_is_one_sentence(arm, change, complains):
    arm.write_text(ARM.replace(*change))
    with complains(UrdfError):
        load(arm)


def test_a_ball_joint_is_held_and_named(arm):
    arm.write_text(ARM.replace('axis="1 1 0"', 'type="ball"').replace('range="-120 120"', ""))
    arm.write_text(arm.read_text().replace('<motor joint="turn" ctrlrange="-20 20" gear="2"/>', ""))
    robot = load(arm)
    assert "of an MJCF: 'turn' is a ball joint; taken as fixed" in robot.notes
    assert robot.joint_names == ("swing", "tilt", "reach")
