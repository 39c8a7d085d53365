"""Each way in which a URDF can be unusable gives one clear sentence."""

import pytest

from urdf import UrdfError, validate

LINK = '<link name="{}"/>'
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
    '<limit lower="-1" upper="1" velocity="2" effort="3"/></joint>'
)


def joint(name: str, parent: str, child: str, kind: str = "revolute") -> str:
    return JOINT.format(name=name, parent=parent, child=child, kind=kind)


def robot(*parts: str) -> str:
    return f'<robot name="toy">{"".join(parts)}</robot>'


def links(*names: str) -> str:
    return "".join(map(LINK.format, names))


TREE = {
    "no links": (robot(), "it has no links"),
    "nothing moves": (robot(links("a", "b"), joint("j", "a", "b", "fixed")), "it has no moving joint"),
    "unknown link": (robot(links("a"), joint("j", "a", "b")), "joint 'j' refers to link 'b', which is not defined"),
    "two parents": (
        robot(links("a", "b", "c"), joint("j", "a", "c"), joint("k", "b", "c")),
        "link 'c' hangs from two joints, 'j' and 'k'",
    ),
    "cycle": (
        robot(links("a", "b"), joint("j", "a", "b"), joint("k", "b", "a")),
        "the links form a cycle, a <- b <- a",
    ),
    "two roots": (robot(links("a", "b", "c"), joint("j", "a", "b")), r"2 links have no parent \(a, c\)"),
    "same name": (robot(links("a", "b", "b"), joint("j", "a", "b")), "link 'b' is defined twice"),
}


@pytest.mark.parametrize(("text", "sentence"), TREE.values(), ids=TREE.keys())
def test_what_is_not_one_tree_is_refused(tmp_path, text: str, sentence: str) -> None:
    path = tmp_path / "toy.urdf"
    path.write_text(text)
    with pytest.raises(UrdfError, match=sentence) as caught:
        validate.check_tree(validate.parse(path), path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_proper_tree_passes(tmp_path) -> None:
    path = tmp_path / "toy.urdf"
    path.write_text(robot(links("a", "b", "c"), joint("j", "a", "b"), joint("k", "b", "c")))
    validate.check_tree(validate.parse(path), path)
    validate.check_limits(validate.parse(path), path, ("j", "k"))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "not an XML file"),
        ("<robot name='x'>", "not an XML file"),
        ("<sdf/>", "the root element is <sdf>, not <robot>"),
    ],
)
def test_what_is_not_a_urdf_is_refused(tmp_path, content: str, sentence: str) -> None:
    path = tmp_path / "toy.urdf"
    path.write_text(content)
    with pytest.raises(UrdfError, match=sentence):
        validate.parse(path)


def test_a_missing_file_is_named(tmp_path) -> None:
    with pytest.raises(UrdfError, match=r"none\.urdf: cannot be read \(No such file or directory\)"):
        validate.parse(tmp_path / "none.urdf")


@pytest.mark.parametrize(
    ("limit", "sentence"),
    [
        ("", "joint 'j' has no limit lower, upper, effort, velocity"),
        ('<limit lower="-1" upper="1" effort="1"/>', "joint 'j' has no limit velocity"),
        (
            '<limit lower="-1" upper="1" effort="1" velocity="0"/>',
            "joint 'j' has velocity limit 0; it must be positive",
        ),
        (
            '<limit lower="1" upper="-1" effort="1" velocity="1"/>',
            "joint 'j' has limits 1 to -1; the lower one must be the smaller",
        ),
        (
            '<limit lower="-1" upper="1" effort="nan" velocity="1"/>',
            "joint 'j' has effort=\"nan\"; it must be a finite",
        ),
    ],
)
def test_a_joint_without_usable_limits_is_named(tmp_path, limit: str, sentence: str) -> None:
    path = tmp_path / "toy.urdf"
    joint = f'<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{limit}</joint>'
    path.write_text(robot(links("a", "b"), joint))
    with pytest.raises(UrdfError, match=sentence):
        validate.check_limits(validate.parse(path), path, ("j",))


def test_an_unknown_joint_lists_the_known_ones(tmp_path) -> None:
    path = tmp_path / "toy.urdf"
    path.write_text(robot(links("a", "b"), joint("j", "a", "b")))
    with pytest.raises(UrdfError, match="there is no joint 'elbow'; choose among j"):
        validate.check_limits(validate.parse(path), path, ("elbow",))


@pytest.mark.parametrize("uri", ["package://toy/hand.stl", "hand.stl", "file:///nowhere/hand.stl"])
def test_a_missing_mesh_is_named(tmp_path, uri: str) -> None:
    path = tmp_path / "toy.urdf"
    shape = f'<link name="a"><visual><geometry><mesh filename="{uri}"/></geometry></visual></link>'
    path.write_text(robot(shape))
    assert validate.find_meshes(validate.parse(path), path) == ((), (uri,))


@pytest.mark.parametrize("uri", ["package://toy/meshes/hand.stl", "../meshes/hand.stl"])
def test_a_mesh_beside_the_urdf_or_in_its_package_is_found(tmp_path, uri: str) -> None:
    (tmp_path / "toy" / "urdf").mkdir(parents=True)
    (tmp_path / "toy" / "meshes").mkdir()
    (tmp_path / "toy" / "meshes" / "hand.stl").write_bytes(b"solid")
    path = tmp_path / "toy" / "urdf" / "toy.urdf"
    path.write_text(robot(f'<link name="a"><visual><geometry><mesh filename="{uri}"/></geometry></visual></link>'))
    root = validate.parse(path)
    directories, missing = validate.find_meshes(root, path)
    assert missing == ()
    assert directories == ((tmp_path,) if uri.startswith("package") else ())
    validate.make_absolute(root, path)
    (mesh,) = root.iter("mesh")
    assert mesh.get("filename").startswith("package://") or mesh.get("filename") == str(
        tmp_path / "toy" / "meshes" / "hand.stl"
    )
