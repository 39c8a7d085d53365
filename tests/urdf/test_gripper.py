"""What holds things is not a part of an arm, whatever it is called."""

from xml.etree import ElementTree as ET

import pytest

from urdf.find import distribution_file
from urdf.gripper import gripper_joints
from urdf.infer import infer_settings
from urdf.validate import MOVING_JOINT_TYPES

LAST = {
    "two fingers, one copies the other": ("panda_description/urdf/panda.urdf", "panda_joint7"),
    "a lone jaw": ("so_arm_description/urdf/so101.urdf", "wrist_roll"),
    "a heavier lone jaw": ("z1_description/urdf/z1.urdf", "joint6"),
    "a jaw that others copy": ("talos_data/robots/talos_left_arm.urdf", "arm_left_7_joint"),
    "a hand of many joints": ("tiago_description/robots/tiago.urdf", "arm_7_joint"),
    "no gripper": ("ur_description/urdf/ur5_robot.urdf", "wrist_3_joint"),
    "a light wrist": ("xarm_description/urdf/xarm7.urdf", "joint7"),
    "a wrist that is called gripper": ("alex_description/urdf/alex_nub_hands.urdf", "LeftGripperYaw"),
}
"""Files of example-robot-data, and the last joint of the arm in each."""


@pytest.mark.parametrize(("file", "last"), LAST.values(), ids=LAST)
def test_the_arm_ends_before_its_gripper_under_any_names(file, last):
    path = distribution_file("example-robot-data", file)
    text = path.read_text(encoding="utf-8")
    root = ET.fromstring(text)
    assert infer_settings(root, path, None, None)[0].arm.joints[-1] == last
    for i, joint in enumerate(root.findall("joint")):
        text = text.replace(f'"{joint.get("name")}"', f'"gripper_{i}"')
    names = dict(zip(*([j.get("name") for j in r.findall("joint")] for r in (root, ET.fromstring(text))), strict=True))
    assert infer_settings(ET.fromstring(text), path, None, None)[0].arm.joints[-1] == names[last]


def test_a_hand_alone_is_no_gripper():
    path = distribution_file("example-robot-data", "allegro_hand_description/urdf/allegro_right_hand.urdf")
    assert gripper_joints(ET.parse(path).getroot()) == frozenset()


def test_two_arms_on_one_trunk_are_no_fingers():
    path = distribution_file("example-robot-data", "baxter_description/urdf/baxter.urdf")
    root = ET.parse(path).getroot()
    moving = {joint.get("name") for joint in root.findall("joint") if joint.get("type") in MOVING_JOINT_TYPES}
    assert moving - gripper_joints(root) >= {f"{side}_{joint}" for side in ("left", "right") for joint in ("s0", "w2")}
