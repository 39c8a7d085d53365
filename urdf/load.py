"""From a name or a path to a robot that can be trusted."""

import hashlib
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from urdf import validate
from urdf.errors import UrdfError
from urdf.find import distribution_file
from urdf.mend import add_frames, mend_inertias
from urdf.robot import Array, Limits, Robot
from urdf.settings import Settings, read_settings

SETTINGS = Path(__file__).parent / "robots"


def known_robots() -> tuple[str, ...]:
    """Names that `load` knows."""
    return tuple(sorted(path.stem for path in SETTINGS.glob("*.toml")))


def load(name_or_path: str | Path = "baxter") -> Robot:
    """Find, validate and mend a robot, and reduce it to its arm.

    Args:
        name_or_path: a known robot's name.

    Returns:
        The robot; what was found wrong and mended is in its ``defects``.

    Raises:
        UrdfError: the description is unknown or cannot be used.
    """
    name = str(name_or_path)
    if name not in known_robots():
        raise UrdfError(f"unknown robot '{name}': choose one of {', '.join(known_robots())}")
    settings = read_settings(SETTINGS / f"{name}.toml")
    path = distribution_file(settings.distribution, settings.urdf_file)
    srdf = None if settings.srdf_file is None else distribution_file(settings.distribution, settings.srdf_file)
    return _assemble(path, srdf, settings)


def _assemble(path: Path, srdf: Path | None, settings: Settings) -> Robot:
    root = validate.parse(path)
    validate.check_tree(root, path)
    validate.check_limits(root, path, settings.joints)
    defects = validate.check_schema(path)
    defects += mend_inertias(root)
    add_frames(root, settings.frames)
    digest = hashlib.sha256(ET.tostring(root)).hexdigest()
    directories = validate.find_meshes(root, path)
    xml = ET.tostring(root, encoding="unicode")
    model = _reduced(xml, settings.joints, path)
    if not model.existFrame(settings.tool_frame):
        raise UrdfError(f"{path}: there is no frame '{settings.tool_frame}'; choose the link that carries the tool")
    return Robot(
        name=settings.name,
        urdf_path=path,
        package_dirs=directories,
        urdf_xml=xml,
        srdf_path=srdf,
        joint_names=settings.joints,
        model=model,
        tool_frame=settings.tool_frame,
        tool_offset=np.array(settings.tool_offset),
        limits=_limits(model, settings),
        home=np.array(settings.home),
        springs=settings.springs,
        collision_exclusions=settings.exclusions,
        limits_source=settings.limits_source,
        defects=tuple(defects),
        fingerprint=hashlib.sha256(f"{digest}\n{settings.text}".encode()).hexdigest(),
        given_line=settings.line,
    )


def _reduced(xml: str, joints: tuple[str, ...], path: Path) -> pin.Model:
    """Model of the arm alone, in the order of its joints from base to tool."""
    full = pin.buildModelFromXML(xml)
    locked = [index for index in range(1, full.njoints) if full.names[index] not in joints]
    model = pin.buildReducedModel(full, locked, pin.neutral(full))
    if tuple(model.names[1:]) != joints:
        raise UrdfError(f"{path}: the arm's joints in order are {', '.join(model.names[1:])}; list them so")
    return model


def _limits(model: pin.Model, settings: Settings) -> Limits:
    return Limits(
        lower=_finite(model.lowerPositionLimit),
        upper=_finite(model.upperPositionLimit),
        velocity=np.array(model.velocityLimit),
        acceleration=np.array(settings.acceleration),
        jerk=np.array(settings.jerk),
        effort=np.array(model.effortLimit),
    )


def _finite(bounds: Array) -> Array:
    return np.array(bounds, dtype=np.float64)
