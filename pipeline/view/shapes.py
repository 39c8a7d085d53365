"""The shape of an arm: meshes of its URDF, made coarse where they are heavy; else a rod for every link."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh

from armdyn.channels import FloatArray
from pipeline.view.scene import DARK, GREY, STEEL, Body, Mesh, capsule
from urdf import Robot
from urdf.find import locate_mesh, package_dirs
from urdf.quiet import quiet

MOST_TRIANGLES = 40_000
"""Of a whole arm: a page of about 1 MB, which a small computer turns smoothly."""
STANDING = 0.3
"""Share of them for what does not move, such as a torso."""
FINEST, COARSEST, COARSER = 0.003, 0.06, 1.4
"""Edge of the cells within which vertices of heavy meshes become one [m], and its growth from one try to the next."""
LARGEST_FILE = 20e6
"""bytes; a mesh beyond it takes longer to read than a person waits for a view."""
SLENDER, THIN, THICK = 0.15, 0.012, 0.06
"""Radius of a rod that stands for a link: over its length, and its bounds [m]."""


@dataclass(frozen=True, eq=False)
class Links:
    """What is drawn of an arm.

    Attributes:
        robot: whose links these are.
        meshes: per joint of the reduced model, the world first: what it moves, in the frame of that joint.
        note: what was left out; empty for nothing.
    """

    robot: Robot
    meshes: Sequence[Sequence[Mesh]]
    note: str = ""

    def bodies(self, q: FloatArray) -> list[Body]:
        """The links at postures q, (k, n) [rad or m]."""
        model = self.robot.model
        data, poses = model.createData(), np.empty((len(q), model.njoints, 7))
        for i, posture in enumerate(q):
            pin.forwardKinematics(model, data, posture)
            poses[i] = [pin.SE3ToXYZQUAT(placement) for placement in data.oMi]
        names = ["base", *list(model.names)[1:]]
        return [
            Body(names[j], meshes, poses[:1, j] if j == 0 else poses[:, j])
            for j, meshes in enumerate(self.meshes)
            if meshes
        ]

    def tool(self, q: FloatArray) -> FloatArray:
        """(k, 3) the tool point at postures q, (k, n), in the world [m]."""
        return np.array([self.robot.tool_pose(posture).translation for posture in q])


def links_of(robot: Robot) -> Links:
    """The meshes of an arm where its URDF has some that can be read, else rods."""
    found, missing = _visuals(robot)
    if not any(found[1:]):
        return Links(robot, _rods(robot), "The URDF's meshes are not on this machine: links are drawn as rods.")
    note = f"{missing} of the URDF's meshes cannot be read and are left out." if missing else ""
    return Links(robot, _coarse(found), note)


def _visuals(robot: Robot) -> tuple[list[list[Mesh]], int]:
    """Per joint the shapes that its links show, as fine as they are; how many meshes cannot be read."""
    root, model = ET.fromstring(robot.urdf_xml), robot.model
    uris = {mesh.get("filename", "") for mesh in root.iter("mesh")}
    packages = {uri.removeprefix("package://").partition("/")[0] for uri in uris if uri.startswith("package://")}
    folders = (*robot.package_dirs, *package_dirs(robot.urdf_path, packages))
    found: list[list[Mesh]] = [[] for _ in range(model.njoints)]
    missing = 0
    colours = {
        material.get("name"): _hex(material.find("color"))
        for material in root.iter("material")
        if material.find("color") is not None
    }
    for link in root.iter("link"):
        name = link.get("name", "")
        if not model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        for visual in link.findall("visual"):
            shape = _shape(visual, robot.urdf_path, folders)
            if shape is None:
                missing += 1
                continue
            material = visual.find("material")
            colour = None if material is None else _hex(material.find("color")) or colours.get(material.get("name"))
            placement = frame.placement * _origin(visual)
            for part in shape:
                vertices = part.vertices @ placement.rotation.T + placement.translation
                found[frame.parentJoint].append(Mesh(vertices, part.faces, colour or part.colour))
    return found, missing


def _shape(visual: ET.Element, urdf_path: Path, folders: tuple[Path, ...]) -> list[Mesh] | None:
    """What a visual shows, in the frame of its origin; None where its mesh cannot be read."""
    geometry = next(iter(visual.find("geometry") or ()), None)
    if geometry is None:
        return None
    if geometry.tag == "mesh":
        file = locate_mesh(geometry.get("filename", ""), urdf_path, folders)
        if file is None or file.stat().st_size > LARGEST_FILE:
            return None
        scale = np.array(_numbers(geometry.get("scale"), (1.0, 1.0, 1.0)))
        try:
            with quiet():
                scene = trimesh.load_scene(file)
                parts = scene.dump(concatenate=False)
        except Exception:  # whatever a reader of meshes may raise of a damaged file
            return None
        whole = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        if not all(np.isfinite(part.vertices).all() for part in whole):
            return None
        return [Mesh(np.asarray(part.vertices) * scale, np.asarray(part.faces), _main_colour(part)) for part in whole]
    primitive: trimesh.Trimesh | None = None
    with suppress(ValueError, TypeError):
        if geometry.tag == "box":
            primitive = trimesh.creation.box(extents=_numbers(geometry.get("size"), ()))
        elif geometry.tag == "sphere":
            primitive = trimesh.creation.icosphere(subdivisions=2, radius=float(geometry.get("radius", "")))
        elif geometry.tag == "cylinder":
            primitive = trimesh.creation.cylinder(
                radius=float(geometry.get("radius", "")), height=float(geometry.get("length", "")), sections=24
            )
    return None if primitive is None else [Mesh(np.asarray(primitive.vertices), np.asarray(primitive.faces), GREY)]


def _main_colour(part: trimesh.Trimesh) -> str:
    visual = part.visual
    material = getattr(visual, "material", None)
    rgba = material.main_color if material is not None else getattr(visual, "main_color", None)
    return GREY if rgba is None else "#{:02X}{:02X}{:02X}".format(*(int(c) for c in rgba[:3]))


def _hex(colour: ET.Element | None) -> str | None:
    if colour is None:
        return None
    rgba = _numbers(colour.get("rgba"), ())
    return "#{:02X}{:02X}{:02X}".format(*(round(255 * min(max(c, 0.0), 1.0)) for c in rgba[:3])) if rgba else None


def _origin(visual: ET.Element) -> pin.SE3:
    origin = visual.find("origin")
    xyz = _numbers(None if origin is None else origin.get("xyz"), (0.0, 0.0, 0.0))
    rpy = _numbers(None if origin is None else origin.get("rpy"), (0.0, 0.0, 0.0))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def _numbers(text: str | None, otherwise: tuple[float, ...]) -> tuple[float, ...]:
    return otherwise if not text else tuple(float(word) for word in text.split())


def _coarse(meshes: Sequence[Sequence[Mesh]]) -> list[list[Mesh]]:
    """Meshes with at most `MOST_TRIANGLES` together, of which what stands still has `STANDING`."""
    still = round(STANDING * MOST_TRIANGLES)
    return [*_reduced(meshes[:1], still), *_reduced(meshes[1:], MOST_TRIANGLES - still)]


def _reduced(meshes: Sequence[Sequence[Mesh]], most: int) -> list[list[Mesh]]:
    """Meshes with at most so many triangles together, the cells as fine as that allows."""
    cell, made = FINEST, [list(of_joint) for of_joint in meshes]
    while sum(len(mesh.faces) for of_joint in made for mesh in of_joint) > most and cell < COARSEST:
        made = [[_clustered(mesh, cell) for mesh in of_joint] for of_joint in made]
        cell *= COARSER
    return made


def _clustered(mesh: Mesh, cell: float) -> Mesh:
    """Vertices within a cell become their mean, and triangles that vanish are left out.

    Source: Rossignac & Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.
    """
    places = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    widths = places.max(axis=0) + 1
    keys = (places[:, 0] * widths[1] + places[:, 1]) * widths[2] + places[:, 2]
    _, where, count = np.unique(keys, return_inverse=True, return_counts=True)
    vertices = np.column_stack([np.bincount(where, mesh.vertices[:, axis]) / count for axis in range(3)])
    faces = where[mesh.faces]
    a, b, c = faces.T
    return Mesh(vertices, faces[(a != b) & (b != c) & (c != a)], mesh.colour, mesh.opacity)


def _rods(robot: Robot) -> list[list[Mesh]]:
    """Per joint a rod to each joint that follows, and from the last one to the tool."""
    model = robot.model
    found: list[list[Mesh]] = [[] for _ in range(model.njoints)]
    origin = np.zeros(3)
    ends = {j: [model.jointPlacements[c].translation for c in range(1, model.njoints) if model.parents[c] == j]
            for j in range(model.njoints)}  # fmt: skip
    tool = model.frames[robot.tool_frame_id]
    ends[tool.parentJoint].append(tool.placement.act(robot.tool_offset))
    longest = max(float(np.linalg.norm(end)) for of_joint in ends.values() for end in of_joint)
    radius = float(np.clip(SLENDER * longest, THIN, THICK))
    for j, of_joint in ends.items():
        colour = DARK if j == 0 else GREY if j % 2 else STEEL
        found[j] += [capsule(origin, end, radius if j else 1.2 * radius, colour) for end in of_joint]
        if not found[j]:
            found[j].append(capsule(origin, origin, radius, colour))
    return found
