"""The robot as MuJoCo draws it: the URDF's visual shapes, the load on its string, the box."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import trimesh

import urdf
from armdyn.errors import InputError
from pipeline.robot.hanging import add_box, add_load, add_string
from pipeline.robot.line_frame import LineFrame
from pipeline.robot.scene import freeze_other_joints
from pipeline.robot.settings import PlantSettings
from urdf.find import locate_mesh

FAINT = 0.25
"""Opacity of the box's walls in a picture."""


def build_picture_scene(robot: urdf.Robot, settings: PlantSettings, size: tuple[int, int]) -> mujoco.MjModel:
    """Model with the same joints, string and load as the plant, to be posed and drawn but not stepped.

    Args:
        robot: the arm.
        settings: load, string and box.
        size: width and height of the largest picture [pixels].
    """
    root = ET.fromstring(robot.urdf_xml)
    for link in root.iter("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    freeze_other_joints(root, robot.joint_names)
    assets = _converted_meshes(root, robot)
    options = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    options.set("discardvisual", "false")
    options.set("strippath", "true")
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"), assets=assets)
    line = LineFrame.of(robot)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0
    tool = spec.body(robot.tool_frame)
    tool.add_site(name="pivot", pos=robot.tool_offset, size=[0.004, 0.004, 0.004], rgba=[0.1, 0.1, 0.1, 1])
    # The load cell, between gripper and string.
    tool.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, 0.0, *robot.tool_offset],
        size=[0.006, 0.0, 0.0],
        rgba=[0.75, 0.75, 0.78, 1.0],
        contype=0,
        conaffinity=0,
    )
    add_load(spec, tool, robot.tool_offset, settings, settings.mass, 0.0)
    add_string(spec, settings.length)
    if settings.box is not None:
        add_box(spec, line, settings.box)
        for geom in spec.geoms:
            if geom.name in ("box_left", "box_right", "box_near"):
                geom.rgba[3] = FAINT
    _furnish(spec, line, size)
    return spec.compile()


def _converted_meshes(root: ET.Element, robot: urdf.Robot) -> dict[str, bytes]:
    """The URDF's meshes in a format that MuJoCo reads, by the new file names that the URDF is given in place."""
    assets: dict[str, bytes] = {}
    names: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        uri = mesh.get("filename", "")
        if uri not in names:
            file = locate_mesh(uri, robot.urdf_path, robot.package_dirs)
            if file is None:
                raise InputError(
                    f"robot '{robot.name}': mesh '{uri}' is missing; install its package to draw the robot"
                )
            names[uri] = f"{len(names)}_{file.stem}.stl"
            assets[names[uri]] = _as_stl(file)
        mesh.set("filename", names[uri])
    return assets


def _as_stl(file: Path) -> bytes:
    shape = trimesh.load(file, force="mesh", process=False)
    stl: bytes = shape.export(file_type="stl")
    return stl


def _furnish(spec: mujoco.MjSpec, line: LineFrame, size: tuple[int, int]) -> None:
    """Light, a floor, and a frame buffer that is large enough."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.55, 0.55, 0.55]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.80, 0.86, 0.93],
        width=256,
        height=256,
    )
    spec.worldbody.add_light(pos=line.origin + np.array([1.5, 0.0, 2.0]), dir=[-0.5, 0.0, -0.8], castshadow=False)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, -0.93],
        size=[4.0, 4.0, 0.1],
        rgba=[0.85, 0.87, 0.9, 1.0],
        contype=0,
        conaffinity=0,
    )
