"""Any URDF: what is chosen where nobody said, what is mended, and what is refused."""

import numpy as np
import pytest

import urdf

LINK = (
    '<link name="{name}"><inertial><mass value="{mass}"/>'
    '<inertia ixx="{ixx}" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
)
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
    '<origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="{axis}"/>{limit}</joint>'
)
LIMIT = '<limit lower="-1.5" upper="2" velocity="2" effort="30"/>'
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")


def link(name: str, mass: float = 1.0, ixx: float = 0.01, shape: str = "") -> str:
    return LINK.format(name=name, mass=mass, ixx=ixx, shape=shape)


def joint(name: str, parent: str, child: str, axis: str = "0 1 0", kind: str = "revolute", limit: str = LIMIT) -> str:
    return JOINT.format(name=name, parent=parent, child=child, axis=axis, kind=kind, limit=limit)


def arm(*more: str, links: tuple[str, ...] | None = None, third: str | None = None) -> str:
    parts = list(links or [link(f"l{i}") for i in range(7)])
    for i, axis in enumerate(AXES):
        parts.append(third if i == 2 and third else joint(f"j{i}", f"l{i}", f"l{i + 1}", axis))
    return f'<robot name="toy">{"".join([*parts, *more])}</robot>'


@pytest.fixture
def toy(tmp_path):
    def write(text: str):
        path = tmp_path / "toy.urdf"
        path.write_text(text)
        return path

    return write


def test_the_longest_chain_is_the_arm_and_its_last_link_the_tool(toy) -> None:
    branch = link("camera") + joint("pan", "l0", "camera")
    hand = '<link name="hand"/>' + joint("wrist", "l6", "hand", kind="fixed", limit="")
    robot = urdf.load(toy(arm(branch, hand)))
    assert robot.joint_names == tuple(f"j{i}" for i in range(6))
    assert robot.tool_frame == "hand"
    assert any("the arm was taken to be j0, j1" in defect for defect in robot.defects)
    assert robot.limits.acceleration == pytest.approx(10 * robot.limits.velocity)
    assert "assumption" in robot.limits_source


def test_an_assumed_home_is_inside_the_limits_and_not_singular(toy) -> None:
    robot = urdf.load(toy(arm()))
    assert robot.limits.margin(robot.home).min() > 0.2
    assert urdf.load(robot.urdf_path).home.tolist() == robot.home.tolist()


def test_some_joints_of_an_arm_make_an_arm(toy) -> None:
    robot = urdf.load(toy(arm()), joints=("j1", "j2"))
    assert robot.model.nv == 2
    assert robot.tool_frame == "l3"
    assert robot.fingerprint != urdf.load(robot.urdf_path).fingerprint


def test_some_joints_of_a_known_robot_keep_its_settings(baxter) -> None:
    part = urdf.load("baxter", joints=baxter.joint_names[:2])
    assert part.home.tolist() == baxter.home[:2].tolist()
    assert [spring.joint for spring in part.springs] == ["right_s1"]
    with pytest.raises(urdf.UrdfError, match="its arm has no joint 'left_s0'"):
        urdf.load("baxter", joints=["left_s0"])


def test_an_endless_joint_gets_one_turn_to_either_side_and_is_listed(toy) -> None:
    third = joint("j2", "l2", "l3", kind="continuous", limit='<limit velocity="2" effort="3"/>')
    robot = urdf.load(toy(arm(third=third)))
    assert robot.limits.upper[2] == pytest.approx(2 * np.pi)
    assert robot.model.nq == 6
    assert any("joint 'j2' is continuous; taken as one turn" in defect for defect in robot.defects)


def test_a_joint_whose_limit_holds_no_positions_is_taken_as_endless(toy) -> None:
    robot = urdf.load(toy(arm(third=joint("j2", "l2", "l3", limit='<limit velocity="2" effort="3"/>'))))
    assert robot.limits.lower[2] == pytest.approx(-2 * np.pi)
    assert any("joint 'j2' has no position limits; taken as one turn" in defect for defect in robot.defects)


@pytest.mark.parametrize(
    ("third", "sentence"),
    [
        (joint("j2", "l2", "l3", limit=""), "joint 'j2' has no limit lower, upper, effort, velocity"),
        (joint("j2", "l2", "l3", kind="continuous", limit=""), "joint 'j2' has no limit effort, velocity"),
        (
            joint("j2", "l2", "l3", limit=LIMIT.replace('"2"', '"fast"', 1)),
            'has upper="fast"; it must be a finite number',
        ),
    ],
)
def test_joints_without_usable_limits_are_refused_in_one_line(toy, third: str, sentence: str) -> None:
    with pytest.raises(urdf.UrdfError, match=sentence) as caught:
        urdf.load(toy(arm(third=third)))
    assert "toy.urdf" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_negative_mass_is_refused(toy) -> None:
    links = (*(link(f"l{i}") for i in range(6)), link("l6", mass=-1.0))
    with pytest.raises(urdf.UrdfError, match="link 'l6': its mass is -1 kg"):
        urdf.load(toy(arm(links=links)))


def test_moments_that_no_body_has_are_listed_and_left(toy) -> None:
    links = (*(link(f"l{i}") for i in range(6)), link("l6", ixx=0.05))
    robot = urdf.load(toy(arm(links=links)))
    assert any("link 'l6': principal moments 0.01, 0.01, 0.05" in defect for defect in robot.defects)
    assert robot.model.inertias[6].inertia[0, 0] == 0.05


def test_a_hand_of_no_mass_is_listed(toy) -> None:
    links = (*(link(f"l{i}") for i in range(6)), '<link name="l6"/>')
    assert any("joint 'j5' carries no mass" in defect for defect in urdf.load(toy(arm(links=links))).defects)


def test_a_missing_mesh_is_refused_or_left_out_and_listed(toy) -> None:
    shape = '<collision><geometry><mesh filename="package://nowhere/hand.stl"/></geometry></collision>'
    path = toy(arm(links=(*(link(f"l{i}") for i in range(6)), link("l6", shape=shape))))
    with pytest.raises(urdf.UrdfError, match=r"mesh 'package://nowhere/hand\.stl' is missing"):
        urdf.load(path)
    robot = urdf.load(path, meshes=False)
    assert any("hand.stl' is missing; left out" in defect for defect in robot.defects)
    urdf.CollisionModel(robot)


def test_inertia_that_its_mesh_cannot_have_is_mended() -> None:
    robot = urdf.load("ur5")
    assert sum("replaced by that of its collision shapes" in defect for defect in robot.defects) == 3
    # The wrist's maker gives about 1e-3 kg m^2; the URDF says 0.22.
    assert 3e-4 < robot.model.inertias[4].inertia.max() < 4e-3


@pytest.mark.parametrize("name", ["ur5", "panda", "talos_arm"])
def test_other_arms_load_with_a_free_home_posture(name: str) -> None:
    robot = urdf.load(name)
    assert robot.limits.margin(robot.home).min() > 0.2
    assert urdf.CollisionModel(robot).touching(robot.home) is None


def test_settings_of_ones_own_name_a_urdf_beside_them(toy) -> None:
    path = toy(arm())
    settings = path.with_name("mine.toml")
    settings.write_text(
        'name = "mine"\n[urdf]\nfile = "toy.urdf"\n[arm]\njoints = ["j0", "j1"]\nhome = [0.1, 0.2]\n'
        '[tool]\nframe = "l6"\noffset = [0, 0, 0.1]\n[limits]\nacceleration = [5, 5]\njerk = [50, 50]\nsource = "me"\n'
    )
    robot = urdf.load(settings)
    assert robot.name == "mine"
    assert robot.tool_frame == "l6"
    settings.write_text("name = ")
    with pytest.raises(urdf.UrdfError, match="is not TOML"):
        urdf.load(settings)
