"""Load a validated robot by its name or from a file."""

import difflib
import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from urdf import infer, validate
from urdf.find import distribution_file, find_meshes, make_mesh_paths_absolute, remove_shapes_without_mesh
from urdf.library_output import library_errors
from urdf.mend import InertiaFault, add_frames, complete_limits, mend_inertias, rename_ambiguous_links
from urdf.robot import URDF_DYNAMICS, ArmDynamics, DescriptionWarning, Limits, Robot, UrdfError, missing_limit_sentences
from urdf.settings import ArmSettings, LimitSettings, RobotSettings, ToolSettings, read_robot_settings
from urdf.validate import MJCF_ROOT_TAG, check_names_and_numbers

if TYPE_CHECKING:
    from urdf.mjcf import CompiledMjcf

SETTINGS_DIRECTORY = Path(__file__).parent / "robots"


def known_robots() -> tuple[str, ...]:
    """Names of the robots that `load` finds without a file."""
    return tuple(sorted(path.stem for path in SETTINGS_DIRECTORY.glob("*.toml")))


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
        joints: the arm's joints from base to tool; by default those of the settings, else the longest chain.
        tool: the link that carries the tool; by default that of the settings, else the last moving link.
        meshes: whether a missing mesh file is an error; if False, shapes whose mesh is missing are removed and listed.

    Returns:
        The robot; its ``defects`` list the faults of the description and how each was repaired.

    Raises:
        UrdfError: the description is unknown or cannot be used.
    """
    name, path = str(name_or_path), Path(name_or_path)
    if joints is not None and not joints:
        raise UrdfError(
            "no joint is named: name the arm's joints from base to tool, or leave them out to take them all"
        )
    if name in known_robots():
        path = SETTINGS_DIRECTORY / f"{name}.toml"
    elif path.suffix.lower() not in (".toml", ".urdf", ".xml") and not path.exists():
        close = difflib.get_close_matches(name, known_robots(), n=1)
        hint = f"did you mean '{close[0]}'? If not," if close else f"choose one of {', '.join(known_robots())}, or"
        raise UrdfError(f"unknown robot '{name}': {hint} give the path of a URDF file")
    if path.suffix.lower() == ".toml":
        text, settings = read_robot_settings(path)
        urdf_path, srdf = _locate(settings, path)
        if joints is not None or tool is not None:
            settings = _narrowed(settings, joints, tool)
            text = f"{text}\n{settings.arm.joints} {tool}"
        robot = _assemble(_read(urdf_path), srdf, settings, text, meshes)
    else:
        description = _read(path)
        settings, said = infer.infer_settings(description.root, path, None if joints is None else tuple(joints), tool)
        text = f"{path.name} {settings.arm.joints} {settings.tool.frame}"
        robot = _assemble(replace(description, notes=(*said, *description.notes)), None, settings, text, meshes)
    for sentence in robot.warnings:
        warnings.warn(f"{robot.name}: {sentence}", DescriptionWarning, stacklevel=2)
    return robot


@dataclass(frozen=True)
class _Description:
    """A checked robot description as a URDF, with the compiled MJCF if it was one.

    `notes` are sentences that a user who makes a model must know; `changed` are sentences about repairs.
    """

    path: Path
    root: ET.Element
    notes: tuple[str, ...]
    changed: tuple[str, ...]
    mjcf: "CompiledMjcf | None" = None

    def dynamics(self, joints: tuple[str, ...]) -> ArmDynamics:
        """Gravity, rotors, damping and springs of an arm."""
        if self.mjcf is None:
            return URDF_DYNAMICS
        from urdf.mjcf_dynamics import arm_dynamics_from_mjcf

        return arm_dynamics_from_mjcf(self.mjcf, joints)

    def left_out(self, joints: tuple[str, ...]) -> list[str]:
        """Sentences on entries about an arm's joints that the arm's model does not include."""
        if self.mjcf is not None:
            return []
        said: dict[tuple[str, str], list[str]] = {
            ("damping", "joint_viscous_friction"): [], ("friction", "joint_coulomb_friction"): [],
        }  # fmt: skip
        for joint in self.root.findall("joint"):
            element = joint.find("dynamics")
            for (key, _), names in said.items():
                if element is not None and joint.get("name") in joints and float(element.get(key, "0")):
                    names.append(f"{joint.get('name')} {float(element.get(key, '0')):g}")
        return [
            f"{key} of <dynamics> ({', '.join(names)}) is not a part of the model: add {effect}, or let repair find it"
            for (key, effect), names in said.items()
            if names
        ]


def _read(path: Path) -> _Description:
    """The URDF in a file, or of the robot in an MJCF."""
    root = validate.parse_description(path)
    mjcf, changed = None, list[str]()
    if root.tag == MJCF_ROOT_TAG:
        from urdf.mjcf import read_mjcf

        mjcf = read_mjcf(path)
        root = mjcf.urdf_root
    validate.check_tree(root, path)
    check_names_and_numbers(root, path)
    if mjcf is None:
        changed = validate.check_schema(path)
    return _Description(
        path,
        root,
        mjcf.notes if mjcf else validate.suspicious_entries(root),
        (*changed, *rename_ambiguous_links(root)),
        mjcf,
    )


def _locate(settings: RobotSettings, source: Path) -> tuple[Path, Path | None]:
    """Files of the URDF and the SRDF named by settings, in a package or beside the settings."""

    def find(key: str, name: str) -> Path:
        package = settings.urdf.distribution
        file = distribution_file(package, name) if package else source.parent / name
        if not file.is_file():
            raise UrdfError(f"{source}: {key}: there is no file {file}; correct the name")
        return file

    srdf = settings.collision.srdf
    return find("[urdf] file", settings.urdf.file), None if srdf is None else find("[collision] srdf", srdf)


def _narrowed(settings: RobotSettings, joints: Sequence[str] | None, tool: str | None) -> RobotSettings:
    """Settings for some of an arm's joints or for another tool, without a line, which would no longer be valid."""
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
        arm=ArmSettings(chosen, those(settings.arm.home)),
        tool=settings.tool if tool is None else ToolSettings(tool, (0.0, 0.0, 0.0)),
        limits=LimitSettings(those(limits.acceleration), those(limits.jerk), limits.source),
        springs=tuple(spring for spring in settings.springs if spring.joint in chosen),
        line=None,
    )


def _assemble(described: _Description, srdf: Path | None, settings: RobotSettings, text: str, meshes: bool) -> Robot:
    """Build the robot from a description, which is mended in place, and its settings.

    The settings' text is part of the robot's fingerprint.
    """
    joints, root, path = settings.arm.joints, described.root, described.path
    validate.check_limits(root, path, joints)
    defects = [*described.changed, *complete_limits(root, joints)]
    directories, missing = find_meshes(root, path)
    if missing and meshes:
        raise UrdfError(
            f"{path}: mesh '{missing[0]}' is missing{f', and {len(missing) - 1} more' if missing[1:] else ''}; "
            "install its package, set ROS_PACKAGE_PATH, or load the robot without its missing meshes"
        )
    defects += remove_shapes_without_mesh(root, missing)
    try:
        judged = mend_inertias(root, path, directories)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    dynamics = described.dynamics(joints)
    links = {link.get("name") for link in root.findall("link")}
    for frame in settings.frames:
        if frame.parent not in links | {other.name for other in settings.frames} or frame.name in links:
            wrong = f"there is no link '{frame.parent}'" if frame.name not in links else "there is such a link already"
            raise UrdfError(f"robot '{settings.name}': [[frames]] {frame.name}: {wrong}; name a link of the URDF")
    add_frames(root, settings.frames)
    digest = hashlib.sha256(ET.tostring(root)).hexdigest()
    make_mesh_paths_absolute(root, path)
    xml = ET.tostring(root, encoding="unicode")
    (model, carried), tool = _reduced(xml, joints, path, dynamics), settings.tool
    if described.mjcf is not None:
        from urdf.mjcf_dynamics import check_torques

        check_torques(described.mjcf, model, dynamics)
    if not model.existFrame(tool.frame):
        known = ", ".join(link.get("name", "") for link in root.findall("link"))
        raise UrdfError(f"{path}: there is no link '{tool.frame}'; choose the link that carries the tool: {known}")
    defects += [*(one.sentence for one in judged), *_weightless(model)]
    lacking = [f"{sentence}, which check, excite and trials need" for sentence in missing_limit_sentences(model)]
    notes = [*described.notes, *described.left_out(joints), *_held(root, carried, joints), *lacking]
    try:
        limits = _limits(model, settings.limits)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    home = np.array(settings.arm.home or infer.choose_home(model, model.getFrameId(tool.frame)))
    outside = np.flatnonzero((home < model.lowerPositionLimit) | (home > model.upperPositionLimit))
    if outside.size:
        worst = int(outside[0])
        raise UrdfError(
            f"robot '{settings.name}': home puts '{joints[worst]}' at {home[worst]:g}, outside its range "
            f"{model.lowerPositionLimit[worst]:g} to {model.upperPositionLimit[worst]:g}; choose a posture inside"
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
        limits_or_none=limits,
        home=home,
        springs=(*settings.springs, *dynamics.springs),
        joint_dynamics=dynamics.joints,
        collision_exclusions=settings.collision.exclude,
        defects=(*notes, *defects),
        notes=tuple(notes),
        warnings=tuple(_warnings(model, judged)),
        fingerprint=hashlib.sha256(f"{digest}\n{text}\n{dynamics}".encode()).hexdigest(),
        line_or_none=None if settings.line is None else settings.line.to_line(),
        assumed_limits=tuple(name for name in ("acceleration", "jerk") if not getattr(settings.limits, name)),
    )


def _reduced(xml: str, joints: tuple[str, ...], path: Path, dynamics: ArmDynamics) -> tuple[pin.Model, list[str]]:
    """Model of the arm alone, with all other joints fixed, and the names of the fixed joints that the arm carries."""
    with library_errors(f"{path}: Pinocchio cannot read it", "correct it"):
        full = pin.buildModelFromXML(xml)
    locked = [index for index in range(1, full.njoints) if full.names[index] not in joints]
    model = pin.buildReducedModel(full, locked, pin.neutral(full))
    if tuple(model.names[1:]) != joints:
        raise UrdfError(f"{path}: the arm's joints in order are {', '.join(model.names[1:])}; list them so")
    model.gravity.linear = np.array(dynamics.gravity)
    model.armature = np.array([dynamics.joints[name].armature if name in dynamics.joints else 0.0 for name in joints])
    unknown = model.lowerPositionLimit == model.upperPositionLimit
    model.lowerPositionLimit = np.where(unknown, -np.inf, model.lowerPositionLimit)
    model.upperPositionLimit = np.where(unknown, np.inf, model.upperPositionLimit)
    for limit in ("velocityLimit", "effortLimit"):
        values = np.array(getattr(model, limit))
        setattr(model, limit, np.where(values > 0.0, values, np.inf))
    moved = {index for index in range(1, full.njoints) if full.names[index] in joints}
    carried = [full.names[i] for i in locked if moved.intersection(list(full.supports[i]))]
    return model, carried


def _held(root: ET.Element, carried: list[str], arm: tuple[str, ...]) -> list[str]:
    """Sentences on joints that an arm carries and that do not move in its model."""
    leaders = validate.mimicked_joints(root)
    said = [
        f"{name} copies {leader} and is held at 0 all the same: no joint of an arm follows another"
        for name, leader in leaders.items()
        if leader in arm
    ]
    others = [name for name in carried if leaders.get(name) not in arm]
    if others:
        beside = "not part of the model: at 0, or where a recording has them; --joints names all joints to compare"
        said.append(f"{', '.join(others)} {beside}")
    return said


def _limits(model: pin.Model, given: LimitSettings) -> Limits | None:
    """Limits of the joints; None where their description lacks them."""
    if missing_limit_sentences(model):
        return None
    velocity = np.array(model.velocityLimit)
    acceleration = (
        np.array(given.acceleration) if given.acceleration else velocity / infer.ASSUMED_SECONDS_TO_FULL_SPEED
    )
    return Limits(
        lower=np.array(model.lowerPositionLimit),
        upper=np.array(model.upperPositionLimit),
        velocity=velocity,
        acceleration=acceleration,
        jerk=np.array(given.jerk) if given.jerk else acceleration / infer.ASSUMED_SECONDS_TO_FULL_ACCELERATION,
        effort=np.array(model.effortLimit),
    )


def _warnings(model: pin.Model, judged: Sequence[InertiaFault]) -> list[str]:
    """Sentences on wrong inertias of links that the arm moves, where they change the torques."""
    moved = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint}
    replaced = [one.link for one in judged if one.link in moved and one.replacement_moments is not None]
    said = [one.sentence for one in judged if one.link in moved and not one.is_possible]
    if replaced:
        said.append(
            f"inertia of {', '.join(replaced)} replaced by that of the collision shapes: no body of their size has it"
        )
    return said


def _weightless(model: pin.Model) -> list[str]:
    """A sentence per joint that moves no mass, whose acceleration under a torque is undefined."""
    data = model.createData()
    pin.computeSubtreeMasses(model, data)
    return [
        f"joint '{model.names[joint]}' carries no mass; left as it is, so that its motion under a torque is undefined"
        for joint in range(1, model.njoints)
        if data.mass[joint] <= 0.0
    ]
