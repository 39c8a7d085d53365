"""One offline page with a scene, drawn by three.js, which the package trimesh brings along."""

import json
from functools import cache
from html import escape
from pathlib import Path
from string import Template

from armdyn import __version__, atomic
from armdyn.errors import InputError
from pipeline.report.page import packed, page_head
from pipeline.view.scene import Scene

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


BEGIN, END = "/**\n * @license", "\n"
"""What stands around the library in trimesh's own viewer: its licence, and the end of the one line that it is."""


@cache
def three_js() -> str:
    """The library as one script that defines ``THREE``; MIT licence, its notice included.

    Raises:
        InputError: trimesh brings it in another form.
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
    # Inside JavaScript's strings and in comments a tag that ends a script would end ours.
    return script.replace("</script", "<\\/script")
