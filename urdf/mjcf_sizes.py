"""Check what an MJCF file makes MuJoCo read and allocate, before MuJoCo opens it.

A file of 100 bytes can ask for a thousand million copies or for a picture of many gigabytes, and can include a pipe, at
which MuJoCo waits for ever.
"""

import os
import struct
import sys
from collections.abc import Iterator
from math import prod
from pathlib import Path
from xml.etree import ElementTree as ET

from urdf.bounds import (
    MAX_MESH_BYTES,
    MAX_MJCF_COUNT,
    MAX_MJCF_PIXELS,
    MAX_TEXT_MESH_BYTES,
    MIB,
    printable_excerpt,
)
from urdf.robot import UrdfError
from urdf.validate import MJCF_ROOT_TAG, parse_description

COUNTS = {
    "replicate": ("count",), "composite": ("count",), "flexcomp": ("count",), "numeric": ("size",), "mesh": ("params",),
    "size": ("nkey", "nuserdata", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam", "nuser_tendon",
             "nuser_actuator", "nuser_sensor"),
    "contact": ("num",), "rangefinder": ("num",),
}  # fmt: skip
"""For each element of an MJCF, its attributes that say how many things there are; of several numbers the product."""
COUNTS_OF_ANY = ("actdim", "nsample")
"""Such attributes of any element."""
PIXELS = {"texture": ("width", "height"), "hfield": ("nrow", "ncol"), "camera": ("resolution",)}
PICTURE_SIDES = 6
"""Number of pictures in a texture of a cube."""
MJCF_ROOTS = (MJCF_ROOT_TAG, "mujocoinclude")
INCLUDING = ("include", "model")
"""Elements whose file is an MJCF too."""
MAX_FILES = 200
"""Largest number of files of one robot."""
PNG_HEAD = b"\x89PNG\r\n\x1a\n"


def check_sizes(path: Path) -> None:
    """Check the files that an MJCF file names, its counts and its pictures; reports the files to Python's audit.

    Raises:
        UrdfError: a file is not regular or is too large, or a number is too large; the message names file and element.
    """
    pixels = 0
    for file, root in _parts(path):
        for element, copies in _with_copies(root, file, 1):
            pixels += _pixels(element)
            wrong = _too_many(element, copies)
            if wrong or pixels > MAX_MJCF_PIXELS:
                said = wrong or f"its pictures and height fields have more than {MAX_MJCF_PIXELS} points"
                raise UrdfError(f"{file}: <{element.tag}> {said}; no robot needs so many: correct it, or leave it out")


def _parts(path: Path) -> Iterator[tuple[Path, ET.Element]]:
    """The file and those that it includes, each once, with their root elements; all other files are checked."""
    waiting, seen, folders, pixels = [path], {path.resolve()}, {""}, 0
    while waiting:
        file = waiting.pop()
        root = parse_description(file, MJCF_ROOTS)
        yield file, root
        for compiler in root.iter("compiler"):
            folders |= {value for key, value in compiler.attrib.items() if key.endswith("dir")}
        for element in root.iter():
            for place in _named(element, {path.parent, file.parent}, folders):
                if place.resolve() in seen:
                    continue
                seen.add(place.resolve())
                pixels += _check_file(place, f"{file}: {printable_excerpt(str(place))} of <{element.tag}>")
                if len(seen) > MAX_FILES or pixels > MAX_MJCF_PIXELS:
                    raise UrdfError(f"{path}: more than {MAX_FILES} files, or {MAX_MJCF_PIXELS} points; reduce it")
                if element.tag in INCLUDING:
                    waiting.append(place)


def _named(element: ET.Element, bases: set[Path], folders: set[str]) -> Iterator[Path]:
    """What is there under the names of files that an element holds."""
    for name in (value for key, value in element.attrib.items() if key.startswith("file") and value):
        yield from (place for base in bases for folder in folders if (place := base / folder / name).exists())


def _check_file(file: Path, what: str) -> int:
    """Check a file, which `what` names in messages, and return the number of points of a picture."""
    if not file.is_file():
        raise UrdfError(f"{what} is not a regular file: name one")
    most = MAX_MESH_BYTES if file.suffix.lower() in (".stl", ".png") else MAX_TEXT_MESH_BYTES
    if file.stat().st_size > most:
        raise UrdfError(f"{what} is larger than {most / MIB:g} MiB; reduce it")
    sys.audit("open", str(file), "rb", os.O_RDONLY)  # MuJoCo does not report the files that it opens
    with file.open("rb") as source:
        head = source.read(24)
    return prod(struct.unpack(">II", head[16:24])) if head.startswith(PNG_HEAD) and len(head) == 24 else 0


def _with_copies(root: ET.Element, file: Path, copies: int) -> Iterator[tuple[ET.Element, int]]:
    """Every element, and the number of its copies; `parse_description` has bounded the depth."""
    for element in root:
        yield element, copies
        inner = copies * max(_product(element.get("count", "1")), 1) if element.tag == "replicate" else copies
        yield from _with_copies(element, file, inner)


def _too_many(element: ET.Element, copies: int) -> str:
    """What is too large; empty where nothing is."""
    for key in (*COUNTS.get(element.tag, ()), *COUNTS_OF_ANY):
        number = _product(element.get(key, "")) * copies
        if number > MAX_MJCF_COUNT:
            of = f", in {copies} copies" if copies > 1 else ""
            return f'has {key}="{printable_excerpt(element.get(key, ""))}"{of}'
    return f"has {copies} copies" if copies > MAX_MJCF_COUNT else ""


def _pixels(element: ET.Element) -> int:
    texts = [element.get(key) for key in PIXELS.get(element.tag, ())]
    number = _product(" ".join(filter(None, texts))) if all(texts) and texts else 0
    if element.tag == "texture" and texts[0] and (not texts[1] or element.get("type", "cube") != "2d"):
        number = PICTURE_SIDES * _product(f"{texts[0]} {texts[0]}")
    return number


def _product(text: str) -> int:
    """Product of the whole numbers of a text; 0 where there is none, so that MuJoCo may say what is wrong."""
    words = text.split()
    try:
        return prod(abs(int(float(word))) for word in words) if words else 0
    except (ValueError, OverflowError):
        return 0
