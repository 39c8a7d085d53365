"""Where robot descriptions live on this machine."""

import os
from importlib import metadata
from pathlib import Path, PurePosixPath

from urdf.robot import UrdfError


def distribution_file(distribution: str, tail: str) -> Path:
    """A data file that an installed Python package carries.

    Args:
        distribution: name of the package, such as ``"example-robot-data"``.
        tail: last parts of the file's path.

    Raises:
        UrdfError: the package or the file is not there.
    """
    try:
        files = metadata.files(distribution) or []
    except metadata.PackageNotFoundError as error:
        raise UrdfError(f"package '{distribution}' is not installed: run 'pip install {distribution}'") from error
    for entry in files:
        if PurePosixPath(entry).match(tail):
            return Path(str(entry.locate())).resolve()
    raise UrdfError(f"package '{distribution}' has no file '{tail}': install another version of it")


def package_dirs(urdf_path: Path, names: set[str]) -> tuple[Path, ...]:
    """Directories that hold the packages which a URDF names in ``package://name/...``.

    The directories above the URDF are tried first, nearest first, then ``$ROS_PACKAGE_PATH``.

    Args:
        urdf_path: the URDF's file.
        names: the package names in it.
    """
    searched = [
        *urdf_path.resolve().parents,
        *map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(":"))),
    ]
    found: list[Path] = []
    for name in sorted(names):
        for directory in searched:
            if (directory / name).is_dir():
                found.append(directory)
                break
    return tuple(dict.fromkeys(found))


def locate_mesh(uri: str, urdf_path: Path, directories: tuple[Path, ...]) -> Path | None:
    """The file that a mesh's ``filename`` means, or None where there is no such file."""
    scheme, found, rest = uri.partition("://")
    if found and scheme == "package":
        candidates = [directory / rest for directory in directories]
    elif found and scheme == "file":
        candidates = [Path(rest)]
    else:
        candidates = [urdf_path.parent / uri]
    return next((path for path in candidates if path.is_file()), None)
