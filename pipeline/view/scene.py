"""A 3-D scene (bodies with poses over time, strings, a trail, marked stretches of time) and its offline page.

The page is drawn by three.js, which the package trimesh brings along.
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
from pipeline.report.page import packed, page_head, template

MAX_FRAMES = 1200
"""Poses that a view holds; what lies between them is interpolated."""
BODY_GREY, STEEL, BODY_DARK, LOAD_COLOUR, WOOD = "#B9C2CC", "#8795A5", "#3A4552", "#D55E00", "#B08655"


class Mesh(NamedTuple):
    """Triangles of one colour.

    Attributes:
        vertices: (n, 3) in the frame of its body [m].
        faces: (m, 3) indices of vertices.
        colour: as ``#RRGGBB``.
        opacity: 1 for opaque, 0 for invisible.
    """

    vertices: FloatArray
    faces: np.ndarray
    colour: str = BODY_GREY
    opacity: float = 1.0


class SceneBody(NamedTuple):
    """A rigid body with its motion.

    Attributes:
        name: name of the link or load.
        meshes: shape of the body.
        poses: (k, 7) position [m] and quaternion x, y, z, w in the world for every frame; (1, 7) where it stands still.
    """

    name: str
    meshes: Sequence[Mesh]
    poses: FloatArray


class Mark(NamedTuple):
    """A stretch of time that is worth a look.

    Attributes:
        start: begin [s].
        end: end [s].
        text: reason, for a person.
    """

    start: float
    end: float
    text: str


@dataclass(frozen=True, eq=False)
class Scene:
    """A motion in space; the z axis points up.

    Attributes:
        title: title of the view.
        kind: "run", "table", "trajectory" or "trial".
        time: (k,) times of the frames [s].
        bodies: bodies to draw.
        cords: ends of each string, (k, 2, 3) [m].
        trail: (k, 3) the path of the load or the tool [m]; None for none.
        marks: stretches of time.
        note: facts that a viewer must know, such as that an angle is the model's.
    """

    title: str
    kind: str
    time: FloatArray
    bodies: Sequence[SceneBody]
    cords: Sequence[FloatArray] = ()
    trail: FloatArray | None = None
    marks: Sequence[Mark] = ()
    note: str = ""

    def data(self) -> dict[str, Any]:
        """The scene as JSON for the page's script; numbers are little-endian 32-bit floats and integers in base64."""
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


def frames(start: float, end: float) -> FloatArray:
    """(k,) times of the frames of a motion [s]: 50 per second, fewer where it is long."""
    return np.linspace(start, end, int(np.clip(round(50.0 * (end - start)) + 1, 2, MAX_FRAMES)))


def standing(position: FloatArray | Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """(1, 7) pose of a body at rest at a position (3,) [m]."""
    return np.array([[*position, 0.0, 0.0, 0.0, 1.0]])


def moved(positions: FloatArray) -> FloatArray:
    """(k, 7) poses of a body that moves along (k, 3) positions [m] without turning."""
    return np.column_stack([positions, np.zeros((len(positions), 3)), np.ones(len(positions))])


def ball(radius: float, colour: str = LOAD_COLOUR) -> Mesh:
    """Mesh of a ball about the origin."""
    return _of(trimesh.creation.icosphere(subdivisions=3, radius=radius), colour)


def capsule(start: FloatArray, end: FloatArray, radius: float, colour: str = BODY_GREY) -> Mesh:
    """Mesh of a rod with round ends between two points (3,) [m]."""
    if np.linalg.norm(end - start) < 1e-6:
        sphere = ball(radius, colour)
        return Mesh(sphere.vertices + start, sphere.faces, colour)
    rod = trimesh.creation.cylinder(radius=radius, segment=np.array([start, end]), sections=24)
    ends = [trimesh.creation.icosphere(subdivisions=2, radius=radius).apply_translation(p) for p in (start, end)]
    return _of(trimesh.util.concatenate([rod, *ends]), colour)


def block(extents: Sequence[float], colour: str = STEEL, opacity: float = 1.0) -> Mesh:
    """Mesh of a box about the origin with edge lengths (3,) [m]."""
    return _of(trimesh.creation.box(extents=np.asarray(extents)), colour, opacity)


def _of(shape: trimesh.Trimesh, colour: str, opacity: float = 1.0) -> Mesh:
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces), colour, opacity)


def _packed(mesh: Mesh) -> dict[str, Any]:
    faces = base64.b64encode(np.ascontiguousarray(mesh.faces, dtype="<u4").tobytes()).decode()
    return {**mesh._asdict(), "vertices": _floats(mesh.vertices), "faces": faces}


def _floats(values: FloatArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


SCENE_KINDS = {"run": "recording", "table": "table of postures", "trajectory": "trajectory", "trial": "trial"}


def view_page(scene: Scene, command: str = "") -> str:
    """HTML page of a scene; it works offline."""
    seconds = f"{scene.time[-1] - scene.time[0]:.1f} s"
    return Template(template("view", "view.html")).substitute(
        head=page_head(scene.title, template("view", "scene.css")),
        title=escape(scene.title),
        subtitle=escape(f"{SCENE_KINDS[scene.kind]}, {seconds}"),
        note=escape(scene.note),
        footer=escape(f"armdyn {__version__}" + (f" · {command}" if command else "")),
        scene=template("view", "scene.js"),
        data=packed(json.dumps(scene.data(), separators=(",", ":"))),
        three=packed(three_js()),
    )


def write_view(scene: Scene, path: Path, command: str = "") -> None:
    """Write the page in one step.

    Raises:
        InputError: the file cannot be written.
    """
    atomic.write_text(path, view_page(scene, command))


BEGIN, END = "/**\n * @license", "\n"
"""What stands around the library in trimesh's own viewer: its licence, and the end of the one line that it is."""


@cache
def three_js() -> str:
    """The library three.js as one script that defines ``THREE``, with the notice of its MIT licence.

    Raises:
        InputError: trimesh contains three.js in another form.
    """
    import io
    import zipfile

    from trimesh import resources

    try:
        with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
            page = archive.read("viewer.html.template").decode("utf-8")
        start = page.index(BEGIN)
        body = page.index("!function", start)
        script = page[start : page.index(END, body)]
    except (OSError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"trimesh brings no three.js ({error}): install trimesh 4.5 or later") from error
    # A tag that ends a script would end ours even inside JavaScript's strings and comments.
    return script.replace("</script", "<\\/script")
