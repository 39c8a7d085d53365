"""`armdyn new arm` as a user meets it: from a URDF with a gripper, from an MJCF."""

from pathlib import Path

import numpy as np
import pytest
import robots

from armdyn.model_file import read_model

MJCF = """
<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" range="-90 90"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
  <body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-120 120" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></body></worldbody></mujoco>
"""


def test_an_mjcf_makes_a_model_that_is_read_again_and_exported(armdyn):
    Path("robot.xml").write_text(MJCF)
    status, out, _ = armdyn("new", "arm", "m.toml", "--mjcf", "robot.xml")
    assert status in (0, None)
    assert "no speed limits" in out
    model = read_model("m.toml")
    assert model.parameters["joint_viscous_friction.coefficient[elbow]"].value == 0.1
    assert model.joints == ("shoulder", "elbow")
    assert armdyn("export", "m.toml", "--out", "again.xml")[0] in (0, None)
    assert armdyn("new", "arm", "again.toml", "--mjcf", "again.xml")[0] in (0, None)
    again = read_model("again.toml")
    for joint in model.joints:
        np.testing.assert_allclose(again.link_parameters()[joint], model.link_parameters()[joint], atol=1e-9)


@pytest.mark.parametrize("ending", ["xml", "urdf"])
def test_an_inertia_that_no_body_has_is_named_and_never_exported(armdyn, refused, ending):
    parts = ("<link name='base'/>", robots.link("a", ixx=0.05), robots.joint("j", "base", "a"))
    Path("arm.urdf").write_text(robots.robot(*parts))
    status, _, err = armdyn("new", "arm", "m.toml", "--urdf", "arm.urdf")
    assert status == 0
    assert "link 'a': principal moments 0.01, 0.01, 0.05 kg m^2 belong to no body" in err
    said = refused("export", "m.toml", "--output", f"out.{ending}", "--incomplete")
    assert "m.toml: link 'a': principal moments" in said
    assert not Path(f"out.{ending}").exists()


def test_an_arm_without_limits_makes_a_model_and_moves_nowhere(armdyn, refused):
    joint = robots.joint("j", "base", "a", kind="continuous", limit="")
    Path("arm.urdf").write_text(robots.robot("<link name='base'/>", robots.link("a"), joint))
    status, out, _ = armdyn("new", "arm", "m.toml", "--urdf", "arm.urdf")
    assert status == 0
    lacks = "joint 'j' has no limit of velocity and effort"
    assert f"{lacks}, which check, excite and trials need" in out
    assert armdyn("arm", "show", "--urdf", "arm.urdf")[0] == 0
    assert f"{lacks}: write it into its description" in refused("excite", "--urdf", "arm.urdf", "--output", "q.csv")
