"""What moved, in three dimensions: poses are those of the arm's kinematics, and the page works offline."""

import re

import numpy as np
import pinocchio as pin
import pytest
from browser import Browser, chromium
from PIL import Image
from worlds.baxter import JOINTS, generate

import urdf
from armdyn.errors import InputError
from armdyn.model_file import base_pendulum
from armdyn.run import Channel, Run, write_run_csv
from pipeline.view.reading import scene_of_file
from pipeline.view.scene import Mesh, block_mesh, scene_page_html
from pipeline.view.shapes import MAX_ARM_TRIANGLES, _clustered, arm_shapes

TIME = np.arange(0.0, 4.0, 0.01)


@pytest.fixture(scope="module")
def ur5():
    return urdf.load("ur5", meshes=False)


@pytest.fixture(scope="module")
def recording(ur5, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "ur5.csv"
    q = ur5.home + 0.3 * np.sin(TIME[:, None] + np.arange(6))
    channels = {f"q.{joint}": Channel(TIME, q[:, i], "rad") for i, joint in enumerate(ur5.joint_names)}
    channels |= {f"tau.{joint}": Channel(TIME, np.cos(TIME), "N m") for joint in ur5.joint_names}
    write_run_csv(Run("ur5", channels), path)
    return path, q


def test_bodies_are_where_the_kinematics_of_the_known_robot_has_them(ur5, recording, tmp_path):
    path, q = recording
    scene = scene_of_file(path)
    assert (scene.kind, scene.title) == ("run", "ur5.csv")
    for frame in (0, 77, len(scene.time) - 1):
        posture = np.array([np.interp(scene.time[frame], TIME, column) for column in q.T])
        data = ur5.model.createData()
        pin.forwardKinematics(ur5.model, data, posture)
        wrist = next(body for body in scene.bodies if body.name == "wrist_3_joint")
        assert np.allclose(wrist.poses[frame], pin.SE3ToXYZQUAT(data.oMi[6]), atol=1e-9)
        assert np.allclose(scene.trail[frame], ur5.tool_pose(posture).translation)
    baxter = tmp_path / "baxter.csv"
    write_run_csv(generate(None, 1.0, 0, duration=1.0, rate=50.0), baxter)
    assert {body.name for body in scene_of_file(baxter).bodies} >= set(JOINTS)


def test_a_load_hangs_where_the_angle_that_was_measured_or_the_models_has_it(tmp_path, complains):
    path, angle, x = tmp_path / "swing.csv", 0.4 * np.sin(5.0 * TIME), 0.1 * np.sin(TIME)
    write_run_csv(Run("swing", {"gripper_x": Channel(TIME, x, "m"), "swing_angle": Channel(TIME, angle, "rad")}), path)
    scene = scene_of_file(path, base_pendulum({"length": "0.5 m"}))
    load = next(body for body in scene.bodies if body.name == "load")
    assert np.allclose(load.poses[:, 0], np.interp(scene.time, TIME, x - 0.5 * np.sin(angle)), atol=1e-4)
    assert np.allclose(np.linalg.norm(scene.cords[0][:, 0] - scene.cords[0][:, 1], axis=1), 0.5)
    assert "not known" in scene_of_file(path).note  # without a model nobody knows the length

    force = Channel(TIME, 0.785 + 0.02 * np.cos(10.3 * TIME), "N")
    write_run_csv(Run("swing", {"load_force": force}), path)
    with complains(InputError):
        scene_of_file(path)
    assert "the model's" in scene_of_file(path, base_pendulum({"mass": "80 g", "length": "0.368 m"})).note


def test_a_trajectory_is_checked_and_its_faults_are_marked(ur5, tmp_path):
    path = tmp_path / "fast.csv"
    q = ur5.home + 0.5 * np.sin(9.0 * TIME[:, None] + np.arange(6))
    names = ",".join(["time [s]", *(f"q.{joint} [rad]" for joint in ur5.joint_names)])
    np.savetxt(path, np.column_stack([TIME, q]), "%.6f", ",", header=names, comments="")
    scene = scene_of_file(path, robot=ur5)
    assert scene.kind == "trajectory"
    assert "Not feasible" in scene.note
    assert any("velocity of shoulder_pan_joint" in mark.text for mark in scene.marks)


def test_an_arm_without_meshes_is_drawn_as_rods(ur5, tmp_path):
    text = ur5.urdf_path.read_text().replace("package://", "package://absent_")
    (tmp_path / "bare.urdf").write_text(text)
    links = arm_shapes(urdf.load(str(tmp_path / "bare.urdf"), meshes=False))
    assert "rods" in links.note
    assert all(links.meshes[1:])
    tips = links.meshes[3][0].vertices  # the forearm's rod reaches to the first wrist joint
    reach = np.linalg.norm(ur5.model.jointPlacements[4].translation)
    assert np.linalg.norm(tips, axis=1).max() == pytest.approx(reach, abs=0.07)


def test_heavy_meshes_become_coarse_and_keep_their_size(ur5):
    links = arm_shapes(ur5)
    assert sum(len(mesh.faces) for of_joint in links.meshes for mesh in of_joint) <= MAX_ARM_TRIANGLES
    fine = block_mesh((1.0, 1.0, 1.0))
    vertices = fine.vertices[fine.faces].reshape(-1, 3)
    once = _clustered(Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3)), 0.1)
    assert (len(once.vertices), len(once.faces)) == (8, len(fine.faces))


BOX_ON_A_FIXED_LINK = """<robot name="arm"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"/><link name="a">{mass}</link><link name="b"><visual><origin xyz="0 0 0.05"/>
<geometry><box size="0.1 0.2 0.3"/></geometry><material name="red"/></visual>{mass}</link>
<joint name="turn" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><origin xyz="0 0 0.4"/>
<limit lower="-1" upper="1" velocity="1" effort="10"/></joint>
<joint name="fixed" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0.7 0 0"/></joint></robot>"""
MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def test_a_shape_is_drawn_where_the_urdf_puts_it_in_its_colour(tmp_path):
    (tmp_path / "arm.urdf").write_text(BOX_ON_A_FIXED_LINK.format(mass=MASS))
    (box,) = arm_shapes(urdf.load(str(tmp_path / "arm.urdf"))).meshes[1]
    assert np.allclose([box.vertices.min(axis=0), box.vertices.max(axis=0)], [[0.65, -0.1, -0.1], [0.75, 0.1, 0.2]])
    assert box.colour == "#FF0000"


def test_what_cannot_be_shown_is_one_line_and_nothing_is_written_over(refused, armdyn, recording, tmp_path, complains):
    rows = b"".join(b"%d,%d\n" % (i, i) for i in range(20))
    for name, content in (("a.npz", b"PK"), ("a.csv", b"time [s],q.arm [rad]\n" + rows)):
        (tmp_path / name).write_bytes(content)
        complains.line(refused("view", name, "--output", "x.html"))
        assert not (tmp_path / "x.html").exists()
    (tmp_path / "x.html").write_text("mine")
    assert armdyn("view", recording[0], "--output", "x.html")[0] == 2
    assert (tmp_path / "x.html").read_text() == "mine"


@pytest.mark.slow
def test_a_browser_draws_it_without_a_network(recording, tmp_path):
    chromium()
    page = tmp_path / "view.html"
    page.write_text(scene_page_html(scene_of_file(recording[0])))
    assert page.stat().st_size < 1_500_000
    assert not re.search(r"(src|href)=.?https?:", page.read_text())
    with Browser(600, 500) as tab:
        tab.go(f"{page.as_uri()}#time=1")
        tab.wait("document.body.dataset.ready")
        tab.picture(tmp_path / "a.png")
        assert tab.ask("document.querySelector('output').textContent") == "1.00 s"
        tab.click(".scrubber button")  # plays
        tab.wait("parseFloat(document.querySelector('output').textContent) > 1.5")
        tab.picture(tmp_path / "b.png")
        assert tab.errors == []
    before, after = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("L"), float) for name in "ab")
    stage = slice(90, 350)
    assert len(np.unique(before[stage])) > 50  # an arm with light on it, not an empty stage
    assert np.abs(before[stage] - after[stage]).max() > 50  # and it moved
