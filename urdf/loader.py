"""From a name or a path to a robot that can be trusted."""

import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from urdf import infer, validate
from urdf.find import distribution_file, find_meshes, leave_out_shapes, make_absolute
from urdf.mend import add_frames, bound_continuous_joints, mend_inertias, tell_apart
from urdf.mjcf import as_urdf
from urdf.quiet import told
from urdf.robot import Limits, Robot, UrdfError
from urdf.settings import Arm, AssumedLimits, Settings, Tool, read_settings
from urdf.validate import MJCF, check_plain

SETTINGS = Path(__file__).parent / "robots"


def known_robots() -> tuple[str, ...]:
    """Names that `load` knows."""
    return tuple(sorted(path.stem for path in SETTINGS.glob("*.toml")))


def load(
    name_or_path: str | Path = "baxter",
    *,
    joints: Sequence[str] | None = None,
    tool: str | None = None,
    meshes: bool = True,
) -> Robot:
    """Find, validate and mend a robot, and reduce it to its arm.

    Args:
        name_or_path: a known robot's name, a URDF file, or a settings file (``.toml``) that names its URDF.
        joints: the arm's joints from base to tool; those of the settings, else the longest chain, if not given.
        tool: the link that carries the tool; chosen likewise.
        meshes: whether every mesh must be there; without it, shapes whose mesh is missing are left out and listed.

    Returns:
        The robot; what was found wrong and what was done about it is in its ``defects``.

    Raises:
        UrdfError: the description is unknown or cannot be used.
    """
    name, path = str(name_or_path), Path(name_or_path)
    if joints is not None and not joints:
        raise UrdfError(
            "no joint is named: name the arm's joints from base to tool, or leave them out to take them all"
        )
    if name in known_robots():
        path = SETTINGS / f"{name}.toml"
    elif path.suffix.lower() not in (".toml", ".urdf", ".xml") and not path.exists():
        close = difflib.get_close_matches(name, known_robots(), n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"choose one of {', '.join(known_robots())}"
        raise UrdfError(f"unknown robot '{name}': {hint} Or give the path of a URDF file")
    if path.suffix.lower() == ".toml":
        text, settings = read_settings(path)
        urdf_path, srdf = _locate(settings, path)
        if joints is not None or tool is not None:
            settings = _narrowed(settings, joints, tool)
            text = f"{text}\n{settings.arm.joints} {tool}"
        return _assemble(urdf_path, *_read(urdf_path), srdf, settings, text, meshes)
    root, changed = _read(path)
    settings, said = infer.infer(root, path, None if joints is None else tuple(joints), tool)
    text = f"{path.name} {settings.arm.joints} {settings.tool.frame}"
    return _assemble(path, root, [*said, *changed], None, settings, text, meshes)


def _read(path: Path) -> tuple[ET.Element, list[str]]:
    """The URDF in a file, or of the robot in an MJCF, checked, and a sentence per change that it needed to be one."""
    root, changed = validate.parse(path), list[str]()
    converted = root.tag == MJCF
    if converted:
        root, changed = as_urdf(path)
    validate.check_tree(root, path)
    check_plain(root, path)
    if not converted:
        changed = validate.check_schema(path)
    return root, [*changed, *tell_apart(root)]


def _locate(settings: Settings, source: Path) -> tuple[Path, Path | None]:
    """Files of the URDF and the SRDF that settings name: in a package, or beside the settings."""

    def find(key: str, name: str) -> Path:
        package = settings.urdf.distribution
        file = distribution_file(package, name) if package else source.parent / name
        if not file.is_file():
            raise UrdfError(f"{source}: {key}: there is no file {file}; correct the name")
        return file

    srdf = settings.collision.srdf
    return find("[urdf] file", settings.urdf.file), None if srdf is None else find("[collision] srdf", srdf)


def _narrowed(settings: Settings, joints: Sequence[str] | None, tool: str | None) -> Settings:
    """Settings for some of an arm's joints, or another tool; a line holds for neither."""
    own = settings.arm.joints
    chosen = own if joints is None else tuple(joints)
    for name in chosen:
        if name not in own:
            raise UrdfError(f"robot '{settings.name}': its arm has no joint '{name}'; choose among {', '.join(own)}")

    def those(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(values[own.index(name)] for name in chosen)

    limits = settings.limits
    return replace(
        settings,
        arm=Arm(chosen, those(settings.arm.home)),
        tool=settings.tool if tool is None else Tool(tool, (0.0, 0.0, 0.0)),
        limits=AssumedLimits(those(limits.acceleration), those(limits.jerk), limits.source),
        springs=tuple(spring for spring in settings.springs if spring.joint in chosen),
        line=None,
    )


def _assemble(
    path: Path, root: ET.Element, changed: list[str], srdf: Path | None, settings: Settings, text: str, meshes: bool
) -> Robot:
    """The robot of a URDF, mended in place, and its settings, whose text is part of the fingerprint."""
    joints = settings.arm.joints
    defects = [*changed, *bound_continuous_joints(root, joints)]
    validate.check_limits(root, path, joints)
    directories, missing = find_meshes(root, path)
    if missing and meshes:
        raise UrdfError(
            f"{path}: mesh '{missing[0]}' is missing{f', and {len(missing) - 1} more' if missing[1:] else ''}; "
            "install its package, set ROS_PACKAGE_PATH, or load the robot without its missing meshes"
        )
    defects += leave_out_shapes(root, missing)
    try:
        defects += mend_inertias(root, path, directories)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    links = {link.get("name") for link in root.findall("link")}
    for frame in settings.frames:
        if frame.parent not in links | {other.name for other in settings.frames} or frame.name in links:
            wrong = f"there is no link '{frame.parent}'" if frame.name not in links else "there is such a link already"
            raise UrdfError(f"robot '{settings.name}': [[frames]] {frame.name}: {wrong}; name a link of the URDF")
    add_frames(root, settings.frames)
    digest = hashlib.sha256(ET.tostring(root)).hexdigest()
    make_absolute(root, path)
    xml = ET.tostring(root, encoding="unicode")
    model, tool = _reduced(xml, joints, path), settings.tool
    if not model.existFrame(tool.frame):
        raise UrdfError(f"{path}: there is no link '{tool.frame}'; choose the link that carries the tool")
    defects += _weightless(model)
    try:
        limits = _limits(model, settings.limits)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    home = np.array(settings.arm.home or infer.assumed_home(model, model.getFrameId(tool.frame)))
    margin = limits.margin(home)
    worst = int(np.argmin(margin))
    if margin[worst] < 0.0:
        raise UrdfError(
            f"robot '{settings.name}': home puts '{joints[worst]}' at {home[worst]:g}, outside its range "
            f"{limits.lower[worst]:g} to {limits.upper[worst]:g}; choose a posture inside"
        )
    return Robot(
        name=settings.name,
        urdf_path=path,
        package_dirs=directories,
        urdf_xml=xml,
        srdf_path=srdf,
        joint_names=joints,
        model=model,
        tool_frame=tool.frame,
        tool_offset=np.array(tool.offset),
        limits=limits,
        home=home,
        springs=settings.springs,
        collision_exclusions=settings.collision.exclude,
        limits_source=" ".join(settings.limits.source.split()),
        defects=tuple(defects),
        fingerprint=hashlib.sha256(f"{digest}\n{text}".encode()).hexdigest(),
        given_line=None if settings.line is None else settings.line.line(),
    )


def _reduced(xml: str, joints: tuple[str, ...], path: Path) -> pin.Model:
    """Model of the arm alone, in the order of its joints from base to tool."""
    with told(f"{path}: Pinocchio cannot read it", "correct it"):
        full = pin.buildModelFromXML(xml)
    locked = [index for index in range(1, full.njoints) if full.names[index] not in joints]
    model = pin.buildReducedModel(full, locked, pin.neutral(full))
    if tuple(model.names[1:]) != joints:
        raise UrdfError(f"{path}: the arm's joints in order are {', '.join(model.names[1:])}; list them so")
    return model


def _limits(model: pin.Model, given: AssumedLimits) -> Limits:
    velocity = np.array(model.velocityLimit)
    acceleration = np.array(given.acceleration) if given.acceleration else velocity / infer.SPEED_UP
    return Limits(
        lower=np.array(model.lowerPositionLimit),
        upper=np.array(model.upperPositionLimit),
        velocity=velocity,
        acceleration=acceleration,
        jerk=np.array(given.jerk) if given.jerk else acceleration / infer.JERK_TIME,
        effort=np.array(model.effortLimit),
    )


def _weightless(model: pin.Model) -> list[str]:
    """A sentence per joint that moves nothing: its acceleration under a torque has no answer."""
    carried = [inertia.mass for inertia in model.inertias]
    for joint in range(model.njoints - 1, 0, -1):
        carried[model.parents[joint]] += carried[joint]
    return [
        f"joint '{model.names[joint]}' carries no mass; left as it is, so that its motion under a torque is undefined"
        for joint in range(1, model.njoints)
        if carried[joint] <= 0.0
    ]
