"""An MJCF as a robot: its torques are MuJoCo's; and grippers are no part of an arm."""

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
    model.dof_damping[:] = model.dof_frictionloss[:] = model.dof_armature[:] = 0.0
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
    said = " | ".join(robot.defects)
    np.testing.assert_allclose(robot.limits.effort, [30.0, 50.0, 40.0, 87.0])
    assert "no limit of force on tilt" in said
    assert "it has no speed limits" in said
    assert "armature, damping, frictionloss" in said
    assert "left out as the gripper's: finger_1, finger_2" in said
    assert load(arm, tool="tip").tool_frame == "tip"


def test_fingers_can_be_asked_for(arm):
    assert load(arm, joints=["reach", "finger_2"]).joint_names == ("reach", "finger_2")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("<worldbody>", "<worldbdy>"), "not an XML file"),
        (('axis="1 1 0"', 'type="ball"'), "joint 'turn' is neither one hinge nor one slide"),
        (('axis="1 1 0"', 'axis="1 1 0"/><joint name="second"'), "give every joint a body of its own"),
        (('mass="1.3"', 'mass="heavy"'), "cannot read it as an MJCF"),
    ],
)
def test_a_broken_mjcf_is_one_sentence(arm, change, says):
    arm.write_text(ARM.replace(*change))
    with pytest.raises(UrdfError, match=says):
        load(arm)


def test_an_empty_mjcf_is_refused(arm):
    arm.write_text("<mujoco/>")
    with pytest.raises(UrdfError, match="no body found"):
        load(arm)


@pytest.mark.parametrize(
    ("robot", "last", "gripper"),
    [
        ("panda_description/urdf/panda.urdf", "panda_joint7", "panda_finger_joint1"),
        ("so_arm_description/urdf/so101.urdf", "wrist_roll", "gripper"),
        ("so_arm_description/urdf/so100.urdf", "wrist_roll", "gripper"),
    ],
)
def test_a_gripper_is_left_out_and_named(robot, last, gripper):
    from urdf.find import distribution_file

    found = load(distribution_file("example-robot-data", robot), meshes=False)
    assert found.joint_names[-1] == last
    assert any(defect.startswith("left out as the gripper's") and gripper in defect for defect in found.defects)
