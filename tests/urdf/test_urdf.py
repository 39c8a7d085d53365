"""Any URDF: what is chosen where nobody said, what is mended, and what is refused in one sentence."""

from xml.etree import ElementTree

import numpy as np
import pytest
from robots import LIMIT, joint, link, robot

import urdf
from urdf.find import find_meshes, make_mesh_paths_absolute

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
SPEED_ONLY = '<limit velocity="2" effort="3"/>'


def arm(*more: str, last: str | None = None, third: str | None = None) -> str:
    """Six joints j0 to j5 between links l0 to l6, the last link or the third joint replaced."""
    parts = [link(f"l{i}") for i in range(6)] + [last or link("l6")]
    for i, axis in enumerate(AXES):
        parts.append(third if i == 2 and third else joint(f"j{i}", f"l{i}", f"l{i + 1}", axis))
    return robot(*parts, *more)


@pytest.fixture
def toy(tmp_path):
    def write(text: str):
        path = tmp_path / "toy.urdf"
        path.write_text(text)
        return path

    return write


def third(limit: str, kind: str = "revolute") -> str:
    return arm(third=joint("j2", "l2", "l3", kind=kind, limit=limit))


XACRO = '<xacro:if xmlns:xacro="http://www.ros.org/wiki/xacro" value="1"/>'
AB, ABC = link("a") + link("b"), link("a") + link("b") + link("c")
REFUSED = {
    "empty": "",
    "half": "<robot name='x'>",
    "another format": "<sdf/>",
    "no links": robot(),
    "nothing moves": robot(AB, joint("j", "a", "b", kind="fixed")),
    "unknown link": robot(link("a"), joint("j", "a", "b")),
    "two parents": robot(ABC, joint("j", "a", "c"), joint("k", "b", "c")),
    "cycle": robot(AB, joint("j", "a", "b"), joint("k", "b", "a")),
    "two roots": robot(ABC, joint("j", "a", "b")),
    "same name": robot(AB, link("b"), joint("j", "a", "b")),
    "speed below 0": third(LIMIT.replace('"2" effort', '"-2" effort')),
    "range reversed": third(LIMIT.replace("-1.5", "3")),
    "text": third(LIMIT.replace('"2"', '"fast"', 1)),
    "nan": third(LIMIT.replace('"30"', '"nan"')),
    "two numbers": third(LIMIT.replace('"30"', '"3 0"')),
    "huge": third(LIMIT.replace('"30"', '"1e12"')),
    "negative mass": arm(last=link("l6", mass=-1.0)),
    "no mass": arm(last=link("l6").replace('<mass value="1.0"/>', "")),
    "no axis": third(LIMIT).replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"'),
    "kind": third(LIMIT, "hinge"),
    "mimics nobody": third(f'{LIMIT}<mimic joint="j9"/>'),
    "no name": robot('<link name=" "/>', link("a"), joint("j", " ", "a")),
    "universe": robot(AB, joint("universe", "a", "b")),
    "xacro": robot(XACRO),
    "xacro, not declared": robot("<xacro:if/>"),
    "xacro, a value": arm(last=link("l6", "${m}")),
    "deep": robot(60 * "<x>" + 60 * "</x>"),
}


@pytest.mark.parametrize("text", REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_used_is_refused_in_one_sentence(toy, text: str, complains) -> None:
    with complains(urdf.UrdfError):
        urdf.load(toy(text))


CHOICES = [{"joints": ("elbow",)}, {"joints": ("j1", "j0")}, {"joints": ()}, {"tool": "nose"}]


@pytest.mark.parametrize("options", CHOICES)
def test_choices_that_a_urdf_does_not_offer_are_refused(toy, options: dict, complains) -> None:
    with complains(urdf.UrdfError):
        urdf.load(toy(arm()), **options)


def test_a_missing_file_and_an_unknown_robot_are_named(tmp_path, complains) -> None:
    for name in (tmp_path / "none.urdf", "baxtre"):
        with complains(urdf.UrdfError):
            urdf.load(name)


MENDED = {
    "endless": (third(SPEED_ONLY, "continuous"), "joint 'j2' is continuous; taken as one turn"),
    "no positions": (third(SPEED_ONLY), "joint 'j2' has no position limits; taken as one turn"),
    "moments of no body": (arm(last=link("l6", ixx=0.05)), "link 'l6': principal moments 0.01, 0.01, 0.05"),
    "no mass": (arm(last='<link name="l6"/>'), "joint 'j5' carries no mass"),
    "named twice": (arm().replace('"l6"', '"j5"'), "link 'j5' is called as a joint is; renamed to 'j5_link'"),
}


@pytest.mark.parametrize(("text", "sentence"), MENDED.values(), ids=MENDED)
def test_what_can_be_mended_or_left_is_listed(toy, text: str, sentence: str) -> None:
    loaded = urdf.load(toy(text))
    assert any(sentence in defect for defect in loaded.defects)
    assert loaded.model.nq == 6
    if "one turn" in sentence:
        assert (loaded.limits.lower[2], loaded.limits.upper[2]) == pytest.approx((-2 * np.pi, 2 * np.pi))
    if "moments" in sentence:
        assert loaded.model.inertias[6].inertia[0, 0] == 0.05


LACKING = {
    "no limit": (third(""), "position and velocity and effort"),
    "endless, no limit": (third("", "continuous"), "velocity and effort"),
    "no speed": (third('<limit lower="-1" upper="1" effort="1"/>'), "velocity"),
    "zeros": (third('<limit lower="0" upper="0" effort="0" velocity="0"/>'), "position and velocity and effort"),
    "effort 0": (third(LIMIT.replace('"30"', '"0"')), "effort"),
}


@pytest.mark.parametrize(("text", "lacking"), LACKING.values(), ids=LACKING)
def test_a_limit_that_is_not_given_is_missed_only_by_what_moves_the_arm(
    toy, text: str, lacking: str, complains
) -> None:
    loaded = urdf.load(toy(text))
    assert f"joint 'j2' has no limit of {lacking}, which check, excite and trials need" in loaded.notes
    poses = [of.tool_pose(np.full(6, 0.3)).homogeneous for of in (loaded, urdf.load(toy(arm())))]
    np.testing.assert_array_equal(*poses)
    with complains(urdf.UrdfError):
        _ = loaded.limits


def test_a_joint_that_copies_one_of_the_arm_is_held_and_named(toy, complains) -> None:
    copy = joint("k", "l3", "x", limit=f'{LIMIT}<mimic joint="j1"/>')
    notes = urdf.load(toy(arm(link("x"), copy))).notes
    assert "k copies j1 and is held at 0 all the same: no joint of an arm follows another" in notes
    with complains(urdf.UrdfError):
        urdf.load(toy(arm(link("x"), copy)), joints=("j0", "k"))


def test_what_is_hardly_meant_or_no_part_of_the_model_is_named(toy) -> None:
    dynamics = '<dynamics damping="0.7" friction="0"/>'
    for text, joints, said in (
        (arm().replace('type="revolute"', 'type="planar"', 1), None,
         "is planar, which no joint of an arm is: it is held where it stands"),
        (arm().replace('0.3" rpy="0 0 0"', '0.3" rpy="0 90 0"', 1), None,
         "joint 'j0' is turned by rpy=\"0 90 0\" in rad: if that is in degrees, correct it"),
        (third(LIMIT + dynamics), None,
         "damping of <dynamics> (j2 0.7) is not a part of the model: add joint_viscous_friction"),
        (arm(), ("j0", "j1", "j3"),
         "j2, j4, j5 not part of the model: at 0, or where a recording has them; --joints names all joints to compare"),
    ):  # fmt: skip
        assert said in " | ".join(urdf.load(toy(text), joints=joints).notes)


def test_an_inertia_of_the_arm_that_was_replaced_or_is_impossible_is_warned_of(toy) -> None:
    shape = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    heavy, impossible = link("l6", ixx=9.0, shape=shape), link("l6", ixx=-0.01)
    for last, said in ((heavy, "inertia of l6 replaced by"), (impossible, "link 'l6': principal moments -0.01")):
        with pytest.warns(urdf.DescriptionWarning, match=said):
            assert any(said in warning for warning in urdf.load(toy(arm(last=last))).warnings)
    far = urdf.load(toy(arm(last=impossible)), joints=("j0", "j1"))
    assert len(far.warnings) == 1  # it still hangs on them


def test_the_longest_chain_is_the_arm_and_its_last_link_the_tool(toy) -> None:
    branch = link("camera") + joint("pan", "l0", "camera")
    hand = '<link name="hand"/>' + joint("wrist", "l6", "hand", kind="fixed", limit="")
    loaded = urdf.load(toy(arm(branch, hand)))
    assert loaded.joint_names == tuple(f"j{i}" for i in range(6))
    assert loaded.tool_frame == "hand"
    assert any("the arm was taken to be j0, j1" in defect for defect in loaded.defects)
    assert loaded.limits.acceleration == pytest.approx(10 * loaded.limits.velocity)
    assert loaded.limits.jerk == pytest.approx(50 * loaded.limits.acceleration)
    # The home that is assumed is inside the limits, and the same each time.
    assert loaded.limits.margin(loaded.home).min() > 0.2
    assert urdf.load(loaded.urdf_path).home.tolist() == loaded.home.tolist()


def test_some_joints_of_an_arm_make_an_arm(toy, baxter, complains) -> None:
    loaded = urdf.load(toy(arm()), joints=("j1", "j2"))
    assert loaded.model.nv == 2
    assert loaded.tool_frame == "l3"
    assert loaded.fingerprint != urdf.load(loaded.urdf_path).fingerprint
    part = urdf.load("baxter", joints=baxter.joint_names[:2])  # keeps its settings
    assert part.home.tolist() == baxter.home[:2].tolist()
    assert [spring.joint for spring in part.springs] == ["right_s1"]
    with complains(urdf.UrdfError):
        urdf.load("baxter", joints=["left_s0"])


@pytest.mark.parametrize("uri", ["package://nowhere/hand.stl", "hand.stl", "file:///nowhere/hand.stl"])
def test_a_missing_mesh_is_refused_or_left_out_and_listed(toy, uri: str, complains) -> None:
    path = toy(arm(last=link("l6", shape=f'<collision><geometry><mesh filename="{uri}"/></geometry></collision>')))
    with complains(urdf.UrdfError):
        urdf.load(path)
    loaded = urdf.load(path, meshes=False)
    assert any("hand.stl' is missing; left out" in defect for defect in loaded.defects)
    urdf.CollisionModel(loaded)


@pytest.mark.parametrize("uri", ["package://toy/meshes/hand.stl", "../meshes/hand.stl"])
def test_a_mesh_beside_the_urdf_or_in_its_package_is_found(tmp_path, uri: str) -> None:
    (tmp_path / "toy" / "urdf").mkdir(parents=True)
    (tmp_path / "toy" / "meshes").mkdir()
    mesh, path = tmp_path / "toy" / "meshes" / "hand.stl", tmp_path / "toy" / "urdf" / "toy.urdf"
    mesh.write_bytes(b"solid")
    shape = f'<visual><geometry><mesh filename="{uri}"/></geometry></visual>'
    root = ElementTree.fromstring(robot(link("a", shape=shape)))
    assert find_meshes(root, path) == ((tmp_path,) if uri.startswith("package") else (), ())
    make_mesh_paths_absolute(root, path)
    (element,) = root.iter("mesh")
    assert element.get("filename") in (uri if uri.startswith("package") else "", str(mesh))


def test_settings_of_ones_own_name_a_urdf_beside_them(toy, complains) -> None:
    settings = toy(arm()).with_name("mine.toml")
    settings.write_text(
        'name = "mine"\n[urdf]\nfile = "toy.urdf"\n[arm]\njoints = ["j0", "j1"]\nhome = [0.1, 0.2]\n'
        '[tool]\nframe = "l6"\noffset = [0, 0, 0.1]\n[limits]\nacceleration = [5, 5]\njerk = [50, 50]\nsource = "me"\n'
    )
    loaded = urdf.load(settings)
    assert loaded.name == "mine"
    assert loaded.tool_frame == "l6"
    settings.write_text("name = ")
    with complains(urdf.UrdfError):
        urdf.load(settings)


@pytest.mark.parametrize("name", ["baxter", "ur5", "panda", "talos_arm"])
def test_known_arms_load_with_a_free_home_posture(name: str) -> None:
    loaded = urdf.load(name)
    assert loaded.limits.margin(loaded.home).min() > 0.2
    assert urdf.CollisionModel(loaded).touching(loaded.home) is None
    if name == "ur5":
        assert sum("replaced by that of its collision shapes" in defect for defect in loaded.defects) == 3
        # The wrist's maker gives about 1e-3 kg m^2; the URDF says 0.22.
        assert 3e-4 < loaded.model.inertias[4].inertia.max() < 4e-3
