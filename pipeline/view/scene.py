"""A 3-D scene (bodies with poses over time, strings, a trail, marked intervals of time) and its offline HTML page.

The page draws with three.js, which is a part of the package trimesh.
"""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
import trimesh

from armdyn import __version__, atomic
from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray
from pipeline.report.page import gzip_base64, page_head_html, template_text

MAX_SCENE_FRAMES = 1200
"""Largest number of frames of a scene; the page interpolates poses between them."""
BODY_GREY, STEEL_COLOUR, BODY_DARK, LOAD_COLOUR, WOOD_COLOUR = "#B9C2CC", "#8795A5", "#3A4552", "#D55E00", "#B08655"


class Mesh(NamedTuple):
    """Mesh of triangles of one colour.

    Attributes:
        vertices: positions of the vertices (n, 3) in the frame of the body [m].
        faces: indices of the three vertices of each triangle (m, 3).
        colour: colour in the form ``#RRGGBB``.
        opacity: 1 for opaque, 0 for invisible.
    """

    vertices: FloatArray
    faces: np.ndarray
    colour: str = BODY_GREY
    opacity: float = 1.0


class SceneBody(NamedTuple):
    """A rigid body of a scene, with its shape and its motion.

    Attributes:
        name: name of the link or load.
        meshes: shape of the body.
        poses: position [m] and quaternion (x, y, z, w) in the world for every frame (k, 7), or (1, 7) for a fixed body.
    """

    name: str
    meshes: Sequence[Mesh]
    poses: FloatArray


class TimeMark(NamedTuple):
    """A marked interval of time of a scene, such as a violation of a limit.

    Attributes:
        start: start [s].
        end: end [s].
        text: reason for the mark.
    """

    start: float
    end: float
    text: str


@dataclass(frozen=True, eq=False)
class Scene:
    """A 3-D scene with moving bodies; the z axis points up.

    Attributes:
        title: title of the page.
        kind: source of the motion: "run" (a recording), "table" (an IK table), "trajectory" or "trial".
        time: times of the frames (k,) [s].
        bodies: bodies to draw.
        cords: end points of each string in every frame (k, 2, 3) [m].
        trail: path of the load or the tool (k, 3) [m]; None for none.
        marks: marked intervals of time.
        note: sentences for the viewer, such as that an angle is a model's prediction.
    """

    title: str
    kind: str
    time: FloatArray
    bodies: Sequence[SceneBody]
    cords: Sequence[FloatArray] = ()
    trail: FloatArray | None = None
    marks: Sequence[TimeMark] = ()
    note: str = ""

    def data(self) -> dict[str, Any]:
        """The scene as JSON for the page's script; arrays are little-endian 32-bit numbers in base64."""
        return {
            "title": self.title,
            "note": self.note,
            "time": _floats(self.time),
            "bodies": [
                {"name": body.name, "poses": _floats(body.poses), "meshes": list(map(_packed, body.meshes))}
                for body in self.bodies
            ],
            "cords": list(map(_floats, self.cords)),
            "trail": None if self.trail is None else _floats(self.trail),
            "marks": [mark._asdict() for mark in self.marks],
        }


def frame_times(start: float, end: float) -> FloatArray:
    """Times of a scene's frames from `start` to `end` (k,) [s]: 50 per second, fewer for a long motion."""
    return np.linspace(start, end, int(np.clip(round(50.0 * (end - start)) + 1, 2, MAX_SCENE_FRAMES)))


def fixed_pose(position: FloatArray | Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """Pose of a fixed body at a position (3,) [m], as poses (1, 7) of a `SceneBody`."""
    return np.array([[*position, 0.0, 0.0, 0.0, 1.0]])


def translated_poses(positions: FloatArray) -> FloatArray:
    """Poses (k, 7) of a body that moves along positions (k, 3) [m] without rotation."""
    return np.column_stack([positions, np.zeros((len(positions), 3)), np.ones(len(positions))])


def ball_mesh(radius: float, colour: str = LOAD_COLOUR) -> Mesh:
    """Mesh of a ball of a radius [m] about the origin."""
    return _of(trimesh.creation.icosphere(subdivisions=3, radius=radius), colour)


def capsule_mesh(start: FloatArray, end: FloatArray, radius: float, colour: str = BODY_GREY) -> Mesh:
    """Mesh of a capsule, a rod with round ends, between two points (3,) [m]."""
    if np.linalg.norm(end - start) < 1e-6:
        sphere = ball_mesh(radius, colour)
        return Mesh(sphere.vertices + start, sphere.faces, colour)
    rod = trimesh.creation.cylinder(radius=radius, segment=np.array([start, end]), sections=24)
    ends = [trimesh.creation.icosphere(subdivisions=2, radius=radius).apply_translation(p) for p in (start, end)]
    return _of(trimesh.util.concatenate([rod, *ends]), colour)


def block_mesh(extents: Sequence[float], colour: str = STEEL_COLOUR, opacity: float = 1.0) -> Mesh:
    """Mesh of a cuboid about the origin with edge lengths (3,) [m]."""
    return _of(trimesh.creation.box(extents=np.asarray(extents)), colour, opacity)


def _of(shape: trimesh.Trimesh, colour: str, opacity: float = 1.0) -> Mesh:
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces), colour, opacity)


def _packed(mesh: Mesh) -> dict[str, Any]:
    faces = base64.b64encode(np.ascontiguousarray(mesh.faces, dtype="<u4").tobytes()).decode()
    return {**mesh._asdict(), "vertices": _floats(mesh.vertices), "faces": faces}


def _floats(values: FloatArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


SCENE_KINDS = {"run": "recording", "table": "table of postures", "trajectory": "trajectory", "trial": "trial"}


def scene_page_html(scene: Scene, command: str = "") -> str:
    """HTML page of a scene; it needs no other file and no network.

    Args:
        scene: scene to show.
        command: command line that made the page, for its last line.
    """
    seconds = f"{scene.time[-1] - scene.time[0]:.1f} s"
    return Template(template_text("view", "view.html")).substitute(
        head=page_head_html(scene.title, template_text("view", "scene.css")),
        title=escape(scene.title),
        subtitle=escape(f"{SCENE_KINDS[scene.kind]}, {seconds}"),
        note=escape(scene.note),
        footer=escape(f"armdyn {__version__}" + (f" · {command}" if command else "")),
        scene=template_text("view", "scene.js"),
        data=gzip_base64(json.dumps(scene.data(), separators=(",", ":"))),
        three=gzip_base64(three_js_source()),
    )


def write_scene_page(scene: Scene, path: Path, command: str = "") -> None:
    """Write the HTML page of a scene to a file, which is never half written.

    Args:
        scene: scene to show.
        path: file to write.
        command: command line that made the page, for its last line.

    Raises:
        InputError: the file cannot be written.
    """
    atomic.write_text(path, scene_page_html(scene, command))


THREE_JS_BEGIN, THREE_JS_END = "/**\n * @license", "\n"
"""Text at which three.js begins in the file of trimesh's viewer (its licence), and at which it ends (its only line)."""


@cache
def three_js_source() -> str:
    """JavaScript of the library three.js from the package trimesh, with its MIT licence; it defines ``THREE``.

    Raises:
        InputError: the installed trimesh does not contain three.js in the expected form.
    """
    import io
    import zipfile

    from trimesh import resources

    try:
        with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
            page = archive.read("viewer.html.template").decode("utf-8")
        start = page.index(THREE_JS_BEGIN)
        body = page.index("!function", start)
        script = page[start : page.index(THREE_JS_END, body)]
    except (OSError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"trimesh brings no three.js ({error}): install trimesh 4.5 or later") from error
    # A tag that ends a script would end ours even inside JavaScript's strings and comments.
    return script.replace("</script", "<\\/script")
