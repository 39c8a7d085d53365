"""Find the files of robot descriptions and their meshes on this computer."""

import os
import sys
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree as ET

from urdf.bounds import MAX_MESH_BYTES, MAX_TEXT_MESH_BYTES, MIB
from urdf.robot import UrdfError


def distribution_file(distribution: str, tail: str) -> Path:
    """Path of a data file of an installed Python package, found by the last parts of its path.

    Raises:
        UrdfError: the package or the file is missing.
    """
    try:
        files = metadata.files(distribution) or []
    except metadata.PackageNotFoundError as error:
        raise UrdfError(f"package '{distribution}' is not installed: run 'pip install {distribution}'") from error
    for entry in files:
        if PurePosixPath(entry).match(tail):
            return Path(str(entry.locate())).resolve()
    raise UrdfError(f"package '{distribution}' has no file '{tail}': install another version of it")


def package_dirs(urdf_path: Path, uris: Iterable[str]) -> tuple[Path, ...]:
    """Directories that contain the packages named in a URDF's meshes as ``package://name/...``.

    The directories above the URDF are tried first, nearest first, then ``$ROS_PACKAGE_PATH``.
    """
    names = {uri.removeprefix("package://").partition("/")[0] for uri in uris if uri.startswith("package://")}
    searched = [
        *urdf_path.resolve().parents,
        *map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(":"))),
    ]
    found = (next((place for place in searched if (place / name).is_dir()), None) for name in sorted(names))
    return tuple(dict.fromkeys(place for place in found if place is not None))


def locate_mesh(uri: str, urdf_path: Path, directories: tuple[Path, ...]) -> Path | None:
    """Path of the file that a mesh's ``filename`` in a URDF refers to; None where there is no such file.

    `directories` contain the packages of ``package://`` names.
    """
    scheme, found, rest = uri.partition("://")
    if found and scheme == "package":
        candidates = [directory / rest for directory in directories]
    elif found and scheme == "file":
        candidates = [Path(rest)]
    else:
        candidates = [urdf_path.parent / uri]
    return next((path for path in candidates if path.is_file()), None)


def find_meshes(root: ET.Element, path: Path) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The directories that contain the packages named in a URDF's meshes, and the ``filename`` of each missing mesh."""
    uris = dict.fromkeys(str(mesh.get("filename")) for mesh in root.iter("mesh") if mesh.get("filename"))
    directories = package_dirs(path, uris)
    places = {uri: locate_mesh(uri, path, directories) for uri in uris}
    for mesh in filter(None, places.values()):
        most = MAX_MESH_BYTES if mesh.suffix.lower() == ".stl" else MAX_TEXT_MESH_BYTES
        if mesh.stat().st_size > most:
            raise UrdfError(f"{path}: mesh {mesh} is larger than {most / MIB:g} MiB; reduce it, or save it as STL")
        sys.audit("open", str(mesh), "rb", os.O_RDONLY)  # Pinocchio opens these files without reporting it to Python
    return directories, tuple(uri for uri, mesh in places.items() if mesh is None)


def make_mesh_paths_absolute(root: ET.Element, path: Path) -> None:
    """Replace relative paths of meshes in a URDF by absolute ones, in place; `path` is the URDF's file."""
    for mesh in root.iter("mesh"):
        uri = str(mesh.get("filename", ""))
        if uri and "://" not in uri:
            mesh.set("filename", str((path.parent / uri).resolve()))


def remove_shapes_without_mesh(root: ET.Element, missing: Iterable[str]) -> list[str]:
    """Remove the visual and collision shapes whose mesh is missing from a URDF, in place; one sentence per mesh."""
    gone = dict.fromkeys(missing)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is not None and mesh.get("filename") in gone:
                link.remove(shape)
    return [f"mesh '{uri}' is missing; left out, and no collision is checked against it" for uri in gone]
