"""One offline page with a scene."""

import json
from functools import cache
from html import escape
from pathlib import Path
from string import Template

from armdyn import __version__, atomic
from pipeline.report.page import packed, page_head
from pipeline.view.scene import Scene
from pipeline.view.three import three_js

TEMPLATES = Path(__file__).parent / "templates"
KINDS = {"run": "recording", "table": "table of postures", "trajectory": "trajectory", "trial": "trial"}


def scene_script() -> str:
    """Defines ``armdynScene(place, data)``."""
    return (TEMPLATES / "scene.js").read_text(encoding="utf-8")


def scene_style() -> str:
    """Style sheet of a scene."""
    return (TEMPLATES / "scene.css").read_text(encoding="utf-8")


def view_page(scene: Scene, command: str = "") -> str:
    """The page as HTML; it needs no network."""
    own = (TEMPLATES / "view.css").read_text(encoding="utf-8")
    seconds = f"{scene.time[-1] - scene.time[0]:.1f} s"
    return Template((TEMPLATES / "view.html").read_text(encoding="utf-8")).substitute(
        head=page_head(scene.title, scene_style() + own),
        title=escape(scene.title),
        subtitle=escape(f"{KINDS[scene.kind]}, {seconds}"),
        note=escape(scene.note),
        footer=escape(f"armdyn {__version__}" + (f" · {command}" if command else "")),
        scene=scene_script(),
        data=packed(json.dumps(scene.data(), separators=(",", ":"))),
        three=_library(),
    )


def write_view(scene: Scene, path: Path, command: str = "") -> None:
    """Write the page in one step.

    Raises:
        InputError: the file cannot be written.
    """
    atomic.write_text(path, view_page(scene, command))


@cache
def _library() -> str:
    return packed(three_js())
