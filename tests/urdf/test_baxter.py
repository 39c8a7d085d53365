"""Baxter as loaded: what its URDF says, what was mended, what the settings add."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

import urdf
from urdf.find import locate_mesh


@pytest.fixture(scope="module")
def original(baxter) -> ElementTree.Element:
    return ElementTree.fromstring(baxter.urdf_path.read_text())


def test_limits_are_those_of_the_urdf_and_the_settings(baxter, original) -> None:
    limits = baxter.limits
    for index, name in enumerate(baxter.joint_names):
        given = {key: float(value) for key, value in original.find(f"joint[@name='{name}']/limit").attrib.items()}
        assert {key: getattr(limits, key)[index] for key in given} == given
    assert limits.acceleration.tolist() == [20.0] * 4 + [40.0] * 3
    assert limits.jerk.min() >= 200.0


def test_the_string_is_attached_at_the_tool_point(baxter) -> None:
    data = baxter.model.createData()
    pin.framesForwardKinematics(baxter.model, data, baxter.home)
    attachment = data.oMf[baxter.model.getFrameId("string_attachment")]
    assert attachment.translation == pytest.approx(baxter.tool_pose(baxter.home).translation, abs=1e-12)
    cell = data.oMf[baxter.model.getFrameId("load_cell")]
    assert np.linalg.norm(cell.translation - attachment.translation) == pytest.approx(0.015)


def test_fingers_no_longer_weigh_on_the_wrist_like_a_ring_of_a_metre(baxter, original) -> None:
    unmended = pin.buildModelFromUrdf(str(baxter.urdf_path))
    locked = [i for i in range(1, unmended.njoints) if unmended.names[i] not in baxter.joint_names]
    unmended = pin.buildReducedModel(unmended, locked, pin.neutral(unmended))
    before, after = (pin.crba(model, model.createData(), baxter.home)[6, 6] for model in (unmended, baxter.model))
    assert before > 0.04
    assert 2e-4 < after < 1e-3
    finger = original.find("link[@name='r_gripper_l_finger']/inertial/inertia")
    assert float(finger.get("ixx")) == 0.01


def test_mending_changes_nothing_but_the_fingers_inertias(baxter, original) -> None:
    mended = ElementTree.fromstring(baxter.urdf_xml)
    for link in original.findall("link"):
        name = link.get("name")
        before, after = link.find("inertial"), mended.find(f"link[@name='{name}']/inertial")
        if before is None or "finger" in name:
            continue
        assert [(e.tag, e.attrib) for e in before.iter()] == [(e.tag, e.attrib) for e in after.iter()], name


def test_a_box_shaped_fingers_tip_gets_the_inertia_of_that_box(baxter) -> None:
    tip = ElementTree.fromstring(baxter.urdf_xml).find("link[@name='l_gripper_l_finger_tip']/inertial/inertia")
    x, y, z = 0.042, 0.0065, 0.037
    assert float(tip.get("ixx")) == pytest.approx(0.01 / 12 * (y**2 + z**2))
    assert float(tip.get("izz")) == pytest.approx(0.01 / 12 * (x**2 + y**2))


def test_every_defect_says_what_and_what_was_done(baxter) -> None:
    too_large = [defect for defect in baxter.defects if "replaced by that of its collision shapes" in defect]
    assert len(too_large) == 8
    assert all("finger" in defect for defect in too_large)
    (too_small,) = [defect for defect in baxter.defects if "'right_gripper_base_link'" in defect]
    assert "3e-08 kg m^2 at 0.3 kg" in too_small
    assert too_small.endswith("left as it is")
    assert len(baxter.defects) == 12  # and two: damping is left out, the fingers are held


def test_every_mesh_is_found(baxter, original) -> None:
    files = {mesh.get("filename") for mesh in original.iter("mesh")}
    assert len(files) > 10
    assert all(locate_mesh(file, baxter.urdf_path, baxter.package_dirs) for file in files)


def test_the_springs_carry_most_of_the_arm_where_it_works(baxter) -> None:
    (spring,) = baxter.springs
    assert (spring.joint, spring.enabled) == ("right_s1", False)
    assert [spring.torque(0.0), spring.torque(np.pi / 2)] == pytest.approx([35.3, 8.2])
    load = pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), baxter.home)[1]
    assert abs(load + spring.torque(baxter.home[1])) < 0.4 * abs(load)


def test_the_line_points_to_the_robots_left_with_the_tool_down(baxter, complains) -> None:
    assert baxter.line.direction.tolist() == [0.0, 1.0, 0.0]
    assert (baxter.line.rotation @ [0.0, 0.0, 1.0]).tolist() == [0.0, 0.0, -1.0]
    assert baxter.line.position(0.45).tolist() == pytest.approx([0.55, 0.14, -0.18])
    with complains(urdf.UrdfError):
        _ = replace(baxter, line_or_none=None).line
