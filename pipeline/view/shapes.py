"""Shapes of an arm's links for 3-D scenes: simplified meshes of its URDF, or rods where the meshes are missing."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
import yourdfpy

from armdyn.recording.channels import FloatArray
from pipeline.view.scene import BODY_DARK, BODY_GREY, STEEL_COLOUR, Mesh, SceneBody, capsule_mesh
from urdf import Robot
from urdf.find import locate_mesh, package_dirs
from urdf.library_output import captured_output

MAX_ARM_TRIANGLES = 40_000
"""Largest number of triangles of an arm, for a page of about 1 MB that a small computer can rotate smoothly."""
TRIANGLE_SHARE_OF_RESTING_LINKS = 0.3
"""Share of `MAX_ARM_TRIANGLES` for links that do not move, such as a torso."""
MIN_MERGE_CELL_EDGE, MAX_MERGE_CELL_EDGE, MERGE_CELL_GROWTH_PER_TRY = 0.003, 0.06, 1.4
"""Smallest and largest edge of the cells in which a mesh's vertices are merged [m], and growth from try to try."""
MAX_DRAWN_MESH_BYTES = 20e6
"""Largest size of a mesh file that is read [bytes]; larger ones take too long."""
ROD_RADIUS_TO_LONGEST_LINK, MIN_ROD_RADIUS, MAX_ROD_RADIUS = 0.15, 0.012, 0.06
"""Radius of a rod that is drawn for a link, divided by the longest link's length; and bounds of the radius [m]."""


@dataclass(frozen=True, eq=False)
class ArmShapes:
    """Shapes of an arm's links for 3-D scenes.

    Attributes:
        robot: description of the arm.
        meshes: meshes that each joint of the arm's model moves, in the frame of the joint; first those of the base.
        note: sentence on missing meshes; empty if none is missing.
    """

    robot: Robot
    meshes: Sequence[Sequence[Mesh]]
    note: str = ""

    def bodies(self, q: FloatArray) -> list[SceneBody]:
        """Bodies of a scene for the links, with poses at the joint positions `q` of each frame (k, n) [rad or m]."""
        model = self.robot.model
        data, poses = model.createData(), np.empty((len(q), model.njoints, 7))
        for i, posture in enumerate(q):
            pin.forwardKinematics(model, data, posture)
            poses[i] = [pin.SE3ToXYZQUAT(placement) for placement in data.oMi]
        names = ["base", *list(model.names)[1:]]
        return [
            SceneBody(names[j], meshes, poses[:1, j] if j == 0 else poses[:, j])
            for j, meshes in enumerate(self.meshes)
            if meshes
        ]

    def tool(self, q: FloatArray) -> FloatArray:
        """Positions of the tool point in the world (k, 3) [m], at joint positions `q` (k, n) [rad or m]."""
        return np.array([self.robot.tool_pose(posture).translation for posture in q])


def arm_shapes(robot: Robot) -> ArmShapes:
    """Shapes of an arm's links: readable meshes of its URDF, or else rods."""
    found, missing = _visuals(robot)
    if not any(found[1:]):
        return ArmShapes(robot, _rods(robot), "The URDF's meshes are not on this machine: links are drawn as rods.")
    note = f"{missing} of the URDF's meshes cannot be read and are left out." if missing else ""
    still = round(TRIANGLE_SHARE_OF_RESTING_LINKS * MAX_ARM_TRIANGLES)
    return ArmShapes(robot, [*_reduced(found[:1], still), *_reduced(found[1:], MAX_ARM_TRIANGLES - still)], note)


def _visuals(robot: Robot) -> tuple[list[list[Mesh]], int]:
    """Visual shapes of the links per joint, in full detail, and the number of unreadable ones."""
    model, found, missing = robot.model, [list[Mesh]() for _ in range(robot.model.njoints)], 0
    with captured_output():
        file = BytesIO(robot.urdf_xml.encode())
        described = yourdfpy.URDF.load(file, load_meshes=False, build_scene_graph=False).robot
    links = [link for link in described.links if model.existFrame(link.name, pin.FrameType.BODY)]
    colours = {material.name: material.color for material in described.materials}
    shown = [visual.geometry for link in links for visual in link.visuals if visual.geometry is not None]
    uris = [geometry.mesh.filename for geometry in shown if geometry.mesh is not None]
    folders = (*robot.package_dirs, *package_dirs(robot.urdf_path, uris))
    for link in links:
        frame = model.frames[model.getFrameId(link.name, pin.FrameType.BODY)]
        for visual in link.visuals:
            parts = None if visual.geometry is None else _shape(visual.geometry, robot.urdf_path, folders)
            missing += parts is None
            material, origin = visual.material, np.eye(4) if visual.origin is None else visual.origin
            given = None if material is None else material.color or colours.get(material.name)
            for part in parts or ():
                part.apply_transform(frame.placement.homogeneous @ origin)
                colour = _hex(255 * np.clip(given.rgba, 0.0, 1.0)) if given is not None else _main_colour(part)
                found[frame.parentJoint].append(Mesh(np.asarray(part.vertices), np.asarray(part.faces), colour))
    return found, missing


def _shape(geometry: yourdfpy.Geometry, urdf_path: Path, folders: tuple[Path, ...]) -> list[trimesh.Trimesh] | None:
    """Mesh of a URDF's visual, in the frame of its origin; None where the mesh cannot be read."""
    try:
        if geometry.box is not None:
            return [trimesh.creation.box(extents=geometry.box.size)]
        if geometry.sphere is not None:
            return [trimesh.creation.icosphere(subdivisions=2, radius=geometry.sphere.radius)]
        if geometry.cylinder is not None:
            size = geometry.cylinder
            return [trimesh.creation.cylinder(radius=size.radius, height=size.length, sections=24)]
        file = locate_mesh(geometry.mesh.filename, urdf_path, folders)
        if file is None or file.stat().st_size > MAX_DRAWN_MESH_BYTES:
            return None
        with captured_output():
            parts = trimesh.load_scene(file).dump(concatenate=False)
        whole = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        for part in whole:
            part.vertices = part.vertices * (1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
        return whole if all(np.isfinite(part.vertices).all() for part in whole) else None
    except Exception:  # a reader of meshes may raise any error for a damaged file
        return None


def _main_colour(part: trimesh.Trimesh) -> str:
    material = getattr(part.visual, "material", None)
    rgba = material.main_color if material is not None else getattr(part.visual, "main_color", None)
    return BODY_GREY if rgba is None or not part.visual.defined else _hex(rgba)


def _hex(rgba: Sequence[float]) -> str:
    return "#{:02X}{:02X}{:02X}".format(*(round(float(c)) for c in rgba[:3]))


def _reduced(meshes: Sequence[Sequence[Mesh]], most: int) -> list[list[Mesh]]:
    """Meshes simplified to at most a number of triangles together, with cells as fine as this allows."""
    cell, made = MIN_MERGE_CELL_EDGE, [list(of_joint) for of_joint in meshes]
    while sum(len(mesh.faces) for of_joint in made for mesh in of_joint) > most and cell < MAX_MERGE_CELL_EDGE:
        made = [[_clustered(mesh, cell) for mesh in of_joint] for of_joint in made]
        cell *= MERGE_CELL_GROWTH_PER_TRY
    return made


def _clustered(mesh: Mesh, cell: float) -> Mesh:
    """A simplified mesh: vertices in one cell are merged to their mean, and vanishing triangles are left out.

    Source: Rossignac & Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.
    """
    places = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    keys = np.ravel_multi_index(tuple(places.T), tuple(places.max(axis=0) + 1))
    _, where, count = np.unique(keys, return_inverse=True, return_counts=True)
    vertices = np.column_stack([np.bincount(where, mesh.vertices[:, axis]) / count for axis in range(3)])
    a, b, c = (faces := where[mesh.faces]).T
    return Mesh(vertices, faces[(a != b) & (b != c) & (c != a)], mesh.colour, mesh.opacity)


def _rods(robot: Robot) -> list[list[Mesh]]:
    """Rods in place of meshes: from each joint to the next ones, and from the last joint to the tool."""
    model, origin = robot.model, np.zeros(3)
    ends = [list[FloatArray]() for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        ends[model.parents[joint]].append(model.jointPlacements[joint].translation)
    tool = model.frames[robot.tool_frame_id]
    ends[tool.parentJoint].append(tool.placement.act(robot.tool_offset))
    longest = max(float(np.linalg.norm(end)) for of_joint in ends for end in of_joint)
    radius = float(np.clip(ROD_RADIUS_TO_LONGEST_LINK * longest, MIN_ROD_RADIUS, MAX_ROD_RADIUS))
    found = []
    for j, of_joint in enumerate(ends):
        colour = BODY_DARK if j == 0 else BODY_GREY if j % 2 else STEEL_COLOUR
        own = [capsule_mesh(origin, end, radius if j else 1.2 * radius, colour) for end in of_joint]
        found.append(own or [capsule_mesh(origin, origin, radius, colour)])
    return found
