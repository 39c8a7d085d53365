"""Pictures of a swing, drawn without a screen through EGL: an animation, or a grid of still pictures."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import trimesh
from PIL import Image

import urdf
from armdyn import atomic
from armdyn.errors import InputError
from pipeline.robot.protocol import Vector
from pipeline.robot.scene import add_box, add_load, add_string, arm_only_urdf
from pipeline.robot.settings import PlantSettings
from pipeline.robot.truth import TrueMotion
from urdf.find import locate_mesh

WALL_OPACITY = 0.25
"""Opacity of the box's front, back and near wall in a picture."""


def build_picture_scene(robot: urdf.Robot, settings: PlantSettings, size: tuple[int, int]) -> mujoco.MjModel:
    """MuJoCo model of arm, string, load and box, for drawing.

    Args:
        robot: description of the arm, with meshes.
        settings: settings of string, load and box.
        size: largest width and height of a picture [pixels].
    """
    root = arm_only_urdf(robot, keep=("visual",))
    assets = _converted_meshes(root, robot)
    options = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    options.set("discardvisual", "false")
    options.set("strippath", "true")
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"), assets=assets)
    line = robot.line
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
            if geom.name in ("box_front", "box_back", "box_near"):
                geom.rgba[3] = WALL_OPACITY
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
            assets[names[uri]] = trimesh.load(file, force="mesh", process=False).export(file_type="stl")
        mesh.set("filename", names[uri])
    return assets


def _furnish(spec: mujoco.MjSpec, line: urdf.Line, size: tuple[int, int]) -> None:
    """Add light, a floor, and a frame buffer that is large enough."""
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


Pixels = npt.NDArray[np.uint8]

PICTURE_GRID_COLUMNS_AND_ROWS = (3, 2)
"""Columns and rows of a grid of still pictures."""
SAMPLES_PER_TRAIL_DOT = 4
"""Samples of the recorded motion between two drawn dots of the load's trail."""
TRAIL_DOT_RADIUS_AND_COLOUR = (0.004, (0.8, 0.1, 0.1, 0.35))
"""Radius [m] and colour of the dots that mark the load's path."""


def render_swing(
    robot: urdf.Robot,
    settings: PlantSettings,
    history: TrueMotion,
    path: Path,
    frames_per_second: float = 12.5,
    size: tuple[int, int] = (640, 480),
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Draw a motion of the simulated robot: as an animation at true speed, or as a grid of six still pictures.

    Args:
        robot: description of the arm, with meshes.
        settings: settings of string, load and box.
        history: the motion.
        path: file to write, ``.gif`` for the animation or ``.png`` for the grid.
        frames_per_second: rate of the animation.
        size: width and height of one picture [pixels].
        progress: called with the number of drawn pictures and their total.

    Raises:
        InputError: another file type, an empty motion, or a machine that cannot draw without a screen.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".png"):
        raise InputError(
            f"{path}: a picture is a .gif (animation) or a .png (grid of still pictures); give one of these endings"
        )
    if len(history.time) == 0:
        raise InputError(f"{path}: the motion is empty, there is nothing to draw; let the robot move first")
    animated = path.suffix == ".gif"
    if animated:
        moments = np.arange(history.time[0], history.time[-1] + 1e-9, 1.0 / frames_per_second)
    else:
        moments = np.linspace(
            history.time[0], history.time[-1], PICTURE_GRID_COLUMNS_AND_ROWS[0] * PICTURE_GRID_COLUMNS_AND_ROWS[1]
        )
    images = []
    for pixels in _frames(robot, settings, history, moments, size):
        images.append(Image.fromarray(pixels))
        if progress is not None:
            progress(len(images), len(moments))
    if animated:
        first, *others = (image.quantize(128) for image in images)
        duration = round(1000 / frames_per_second)
        with atomic.replace_file(path) as file:
            first.save(file, "gif", save_all=True, append_images=others, duration=duration, loop=0)
    else:
        with atomic.replace_file(path) as file:
            _sheet(images).save(file, "png")


def _frames(
    robot: urdf.Robot,
    settings: PlantSettings,
    history: TrueMotion,
    moments: npt.NDArray[np.float64],
    size: tuple[int, int],
) -> Iterator[Pixels]:
    """Pictures (height, width, 3) of the robot at the given times [s]."""
    model = build_picture_scene(robot, settings, size)
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in robot.joint_names]
    load = model.joint("load").qposadr[0]
    camera = _camera(robot.line)
    with _drawing(model, size) as draw:
        for index in np.clip(np.searchsorted(history.time, moments - 1e-9), 0, len(history.time) - 1):
            data.qpos[joints] = history.q[index]
            data.qpos[load : load + 3] = history.load[index]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_tendon(model, data)
            yield draw(data, camera, history.load[: index + 1 : SAMPLES_PER_TRAIL_DOT])


def _camera(line: urdf.Line) -> mujoco.MjvCamera:
    """A camera that looks across the line, with growing s to the right, and shows the gripper's travel and the box."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat = line.origin + 0.18 * line.direction - np.array([0.0, 0.0, 0.08])
    camera.distance = 1.3
    # From this direction the line runs to the right.
    towards = np.array([-line.direction[1], line.direction[0]])
    camera.azimuth = float(np.degrees(np.arctan2(towards[1], towards[0])))
    camera.elevation = -10.0
    return camera


@contextmanager
def _drawing(
    model: mujoco.MjModel, size: tuple[int, int]
) -> Iterator[Callable[[mujoco.MjData, mujoco.MjvCamera, Vector], Pixels]]:
    """A function that draws the posed model; graphics memory is given back at the end.

    MuJoCo's own `Renderer` picks its graphics library when `mujoco` is first imported; here it is EGL in any case.
    """
    width, height = size
    context = _egl_context(width, height)
    try:
        scene = mujoco.MjvScene(model, maxgeom=2000)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        option, viewport = mujoco.MjvOption(), mujoco.MjrRect(0, 0, width, height)
        renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, renderer)

        def draw(data: mujoco.MjData, camera: mujoco.MjvCamera, trail: Vector) -> Pixels:
            every = mujoco.mjtCatBit.mjCAT_ALL.value
            mujoco.mjv_updateScene(model, data, option, mujoco.MjvPerturb(), camera, every, scene)
            _add_trail(scene, trail)
            mujoco.mjr_render(viewport, scene, renderer)
            pixels = np.empty((height, width, 3), dtype=np.uint8)
            mujoco.mjr_readPixels(pixels, None, viewport, renderer)
            return pixels[::-1]

        yield draw
        renderer.free()
    finally:
        context.free()


def _add_trail(scene: mujoco.MjvScene, points: Vector) -> None:
    """Add dots at the given points (k, 3) [m] to the scene."""
    radius, colour = TRAIL_DOT_RADIUS_AND_COLOUR
    for point in points[: scene.maxgeom - scene.ngeom]:
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_SPHERE.value,
            np.full(3, radius),
            np.asarray(point, dtype=np.float64),
            np.eye(3).ravel(),
            np.array(colour, dtype=np.float32),
        )
        scene.ngeom += 1


def _egl_context(width: int, height: int) -> "mujoco.egl.GLContext":
    """A current graphics context without a screen.

    Raises:
        InputError: EGL is missing here, with what to install.
    """
    try:
        from mujoco.egl import GLContext

        context = GLContext(width, height)
        context.make_current()
    except (ImportError, AttributeError, RuntimeError, OSError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(
            f"no picture: EGL cannot draw on this machine ({reason}); on Debian and Ubuntu install libegl1, "
            "libegl-mesa0 and libgl1-mesa-dri, or leave the picture out"
        ) from error
    return context


def _sheet(images: list[Image.Image]) -> Image.Image:
    """The pictures in a grid, row by row."""
    width, height = images[0].size
    sheet = Image.new("RGB", (PICTURE_GRID_COLUMNS_AND_ROWS[0] * width, PICTURE_GRID_COLUMNS_AND_ROWS[1] * height))
    for index, image in enumerate(images):
        sheet.paste(
            image,
            (index % PICTURE_GRID_COLUMNS_AND_ROWS[0] * width, index // PICTURE_GRID_COLUMNS_AND_ROWS[0] * height),
        )
    return sheet
