"""`armdyn new arm` as a user meets it: from a URDF with a gripper, from an MJCF."""

from pathlib import Path

import numpy as np

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
    assert "damping" in out
    model = read_model("m.toml")
    assert model.joints == ("shoulder", "elbow")
    assert armdyn("export", "m.toml", "--out", "again.xml")[0] in (0, None)
    assert armdyn("new", "arm", "again.toml", "--mjcf", "again.xml")[0] in (0, None)
    again = read_model("again.toml")
    for joint in model.joints:
        np.testing.assert_allclose(again.link_parameters()[joint], model.link_parameters()[joint], atol=1e-9)
