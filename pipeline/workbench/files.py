"""Files of the workbench's page: files that the user drops onto it, and files that the user saves from it.

Dropped files are read like files on the command line. Saved are the model, a report, and the model for other tools.
"""

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from armdyn import atomic
from armdyn.arm.model import ArmModel
from armdyn.checked_study import CheckedStudy
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.model_file import ModelFile, base_pendulum, read_model_file, write_model_file
from armdyn.quoting import shell_quoted_command
from armdyn.read_files import allow_overwrite
from armdyn.run import Run, read_run, write_run_csv
from ik.child_processes import is_running
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.workbench.bench import Workbench

PAGE_FOLDER_PREFIX = "armdyn-page-"


def new_page_folder() -> tempfile.TemporaryDirectory[str]:
    """New temporary folder for the files of one browser tab while it is open."""
    return tempfile.TemporaryDirectory(prefix=f"{PAGE_FOLDER_PREFIX}{os.getpid()}-", ignore_cleanup_errors=True)


def remove_page_folders() -> None:
    """Remove the temporary folders of all browser tabs of this process."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PAGE_FOLDER_PREFIX}{os.getpid()}-*"):
        shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned_page_folders() -> None:
    """Remove temporary folders of workbench processes that no longer run."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PAGE_FOLDER_PREFIX}*-*"):
        number = folder.name.removeprefix(PAGE_FOLDER_PREFIX).partition("-")[0]
        if number.isdecimal() and not is_running(int(number)):
            shutil.rmtree(folder, ignore_errors=True)


class WritableFileCheck:
    """Check of files that pages want to write: new files in the workbench's folder, and files that pages have written.

    Args:
        folder: folder in which the workbench was started; its subfolders are included.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._written: dict[Path, str] = {}

    def check(self, file: Path, over: bool) -> None:
        """Refuse a file that may not be written.

        Args:
            file: file to write.
            over: whether a file that a page has written may be replaced.

        Raises:
            InputError: the file is outside the folder, exists already, or was changed since a page wrote it.
        """
        target = file.resolve()
        if not target.is_relative_to(self._folder):
            raise InputError(
                f"{file} is not below {self._folder}, where the workbench was started: choose a name in it"
            )
        if not target.exists():
            return
        if not over:
            raise InputError(f"{file} is there already: choose another name, or tick 'write over'")
        if not target.is_file() or self._written.get(target) != _digest(target):
            raise InputError(
                f"{file} exists and was not written by this page or was changed since, so it stays: choose another name"
            )
        allow_overwrite(target)

    def register(self, file: Path) -> None:
        """Register a file that a page has written, with its present contents."""
        self._written[file.resolve()] = _digest(file)


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def is_in_page_folder(file: Path) -> bool:
    """Whether a file is in the temporary folder of a browser tab."""
    return any(parent.name.startswith(PAGE_FOLDER_PREFIX) for parent in file.resolve().parents)


class DroppedFile(NamedTuple):
    """A file that was dropped onto the page, and its kind.

    Attributes:
        kind: "run" (a recording), "model", or "sidecar" (a TOML file beside a recording).
        path: file to use, which may be a converted one.
        said: sentence for the user.
    """

    kind: str
    path: Path
    said: str


def dropped_file_path(folder: Path, name: str) -> Path:
    """Path in a folder for a dropped file, with its name but without parts that lead to another folder.

    Raises:
        InputError: no usable name remains.
    """
    plain = re.sub(r"[^\w .+()-]", "_", Path(name.replace("\\", "/")).name).strip(" .")
    if not plain:
        raise InputError(f"{name!r:.60} is not a name of a file: rename it")
    return folder / plain


def read_dropped(path: Path, joints: Sequence[str] = ()) -> DroppedFile:
    """Read a dropped file, determine its kind, and convert it if necessary.

    Args:
        path: path of the file.
        joints: names of the arm's joints, for columns that are only numbered; empty for no arm.

    Raises:
        InputError: the file cannot be used; the message is one sentence.
    """
    suffix = path.suffix.lower()
    if suffix in (".urdf", ".xml"):
        return _arm_of(path)
    if suffix == ".toml":
        return _toml(path)
    return _recording(path, joints)


def write_pendulum_model(folder: Path, mass: str, length: str) -> Path:
    """Write the model file of a new pendulum.

    Args:
        folder: folder to write to.
        mass: mass of the load, such as "80 g +/- 0.4 g"; empty if it is unknown.
        length: length of the pendulum, such as "0.368 m +/- 1 mm"; empty if it is unknown.

    Raises:
        InputError: a value or unit cannot be read.
    """
    known = {name: text.strip() for name, text in (("mass", mass), ("length", length)) if text.strip()}
    return _write_model(folder / "pendulum.toml", ModelFile(base_pendulum(known), {}))


def write_known_arm_model(folder: Path, robot: str) -> Path:
    """Write the model file of an arm that is known by name, such as ``baxter``.

    Raises:
        InputError: no arm has this name.
    """
    from armdyn.arm.model import arm_model

    made = arm_model(robot=robot)
    return _write_model(folder / f"{robot}.toml", ModelFile(made, {"robot": robot, "joints": list(made.joints)}))


def _arm_of(path: Path) -> DroppedFile:
    from armdyn.arm.described import with_described_effects
    from armdyn.arm.model import arm_model

    made = with_described_effects(arm_model(path))
    said = [f"{path.name}: an arm with the joints {', '.join(made.joints)}"]
    said += [*made.arm.robot.warnings, *made.arm.robot.notes]
    model = _write_model(path.with_suffix(".toml"), ModelFile(made, {"joints": list(made.joints)}))
    return DroppedFile("model", model, ". ".join(said))


def _toml(path: Path) -> DroppedFile:
    from armdyn.recording.sidecar import read_sidecar
    from armdyn.toml_file import read_toml

    table = read_toml(path)
    if "base" in table:
        model: Model = read_model_file(path).model
        effects = ", ".join(effect.label for effect in model.named_effects)
        return DroppedFile(
            "model", path, f"{path.name}: a model of base '{model.base}'" + (f" with {effects}" * bool(effects))
        )
    read_sidecar(path)
    return DroppedFile("sidecar", path, f"{path.name}: describes the recording of the same name")


def _recording(path: Path, joints: Sequence[str]) -> DroppedFile:
    """A recording in armdyn's format, or one converted from columns whose names, units and ranges suggest a meaning."""
    try:
        run = read_run(path)
        return DroppedFile("run", path, f"{path.name}: {_contents(run)}")
    except InputError as error:
        own = error
    from pipeline.imports import read_foreign
    from pipeline.imports.conversion import run_from_recording
    from pipeline.imports.guess import guess_map, map_unambiguous_columns
    from pipeline.imports.joints import RobotJoints

    try:
        foreign = read_foreign(path)[0]
        try:
            mapping = map_unambiguous_columns(foreign)
        except InputError:
            mapping = guess_map([foreign], RobotJoints(tuple(joints)))
        run = run_from_recording(foreign, mapping).run
    except InputError as error:
        # For a run of our own the message says what is wrong; for another format it says what is missing.
        raise (own if path.suffix.lower() == ".csv" and "[" in str(own) else error) from error
    target = path.with_name(f"{path.stem}.csv" if path.suffix.lower() != ".csv" else f"{path.stem}_run.csv")
    write_run_csv(run, target)
    columns = ", ".join(f"{column} as {entry.channel}" for column, entry in list(mapping.entries.items())[:4])
    more = f" and {len(mapping.entries) - 4} more" if len(mapping.entries) > 4 else ""
    doubts = list(mapping.asked.values())
    asked = f"; not sure of {len(doubts)}, such as {doubts[0]}" if doubts else ""
    return DroppedFile("run", target, f"{path.name}: taken as {_contents(run)}, with {columns}{more}{asked}")


def _contents(run: Run) -> str:
    seconds = max(float(channel.time[-1]) for channel in run.channels.values())
    kinds = ", ".join(dict.fromkeys(name.partition(".")[0] for name in run.channels))
    joints = f" of {len(run.joints)} joints" if run.joints else ""
    return f"{kinds}{joints}, {seconds:.1f} s"


def _write_model(path: Path, file: ModelFile) -> Path:
    write_model_file(path, file)
    return path


def write_discovered_laws(folder: Path, own: Path | None, text: str) -> Path:
    """Write a Python file that defines the effects of the user's file, if any, and those of discovered laws.

    Args:
        folder: folder to write to.
        own: the user's file of effects; None for none.
        text: Python text that defines the discovered laws.
    """
    before = "" if own is None else own.read_text(encoding="utf-8") + "\n\n"
    target = folder / "discovered.py"
    atomic.write_text(target, before + text)
    return target


class SavedFiles(NamedTuple):
    """Files that were saved from a page.

    Attributes:
        files: written files, in the order of writing.
        sentence: sentence on the repaired model and its error.
        notes: sentences on parts of the model that a format cannot express, and on a file that was not written.
        next_step: command line of a useful next step.
    """

    files: tuple[Path, ...]
    sentence: str
    notes: tuple[str, ...]
    next_step: str


def save_model(
    opened: ModelAndRunInputs,
    given: CheckedStudy,
    bench: Workbench,
    effects: Sequence[str],
    model: Path,
    report: Path | None = None,
    exported: Path | None = None,
    *,
    writable: WritableFileCheck,
    over: bool = False,
) -> SavedFiles:
    """Add effects to the model one after the other, and write the files of the commands `add` and `export`.

    Args:
        opened: opened input files.
        given: model and recordings as they were read.
        bench: workbench of these files.
        effects: labels of the ticked effects.
        model: model file to write.
        report: report to write; None for none.
        exported: file for another tool, whose ending gives the format; None for none.
        writable: check of the files to write.
        over: whether files that a page has written may be replaced.

    Raises:
        InputError: a file cannot be written, or exists already.
        TaskFailedError: the fit failed.
    """
    from armdyn.document import NextStep
    from armdyn.identify.repair import require_fit
    from pipeline.console.outputs import check_outputs
    from pipeline.exports import write_export
    from pipeline.report.page import write_page
    from pipeline.report.repair import repair_report

    if model.suffix.lower() != ".toml":
        raise InputError(f"{model}: end the name of a model file in .toml")
    study = given.study
    check_outputs(model, report, exported, inputs=opened.recordings)
    for target in (model, report, exported):
        if target is not None:
            writable.check(target, over)
    found = require_fit(given.add(bench.effects_of(effects)))
    kept, copied = _with_its_urdf(found.model, model, writable, over)
    if opened.effects is not None and is_in_page_folder(opened.effects):
        laws = model.with_name(f"{model.stem}_effects.py")
        copied += _copied(opened.effects, laws, writable, over)
        opened = replace(opened, effects=laws)
    file = ModelFile(kept, given.known.file.description, (*given.known.file.history, *found.history))
    write_model_file(model, file)
    files, notes = [model, *copied], list[str]()
    command = replace(opened, model=model).proposed_command("compare", "--report", "compare.html")
    if report is not None:
        write_page(repair_report(study, found, [NextStep("hold it against runs", command)]), report)
        files.append(report)
    if exported is not None:
        written = write_export(file, exported, model.name)
        notes += written.notes
        if written.missing is not None:
            notes.append(written.missing.sentence)
        if written.refused:
            again = shell_quoted_command("export", model, "--output", exported, "--incomplete")
            notes.append(f"{exported} is not written; to write it all the same: {again}")
        else:
            files.append(exported)
    for one in files:
        writable.register(one)
    return SavedFiles(tuple(files), found.sentence, tuple(notes), command)


def _with_its_urdf(found: Model, model: Path, writable: WritableFileCheck, over: bool) -> tuple[Model, list[Path]]:
    """The model, with a dropped URDF copied beside its file, because a page's folder is temporary."""
    arm = found.capability(ArmModel)
    if arm is None or arm.arm.file is None or not is_in_page_folder(arm.arm.file):
        return found, []
    target = model.parent / arm.arm.file.name
    copied = _copied(arm.arm.file, target, writable, over)
    return replace(arm, arm=replace(arm.arm, file=target.resolve())), copied


def _copied(file: Path, target: Path, writable: WritableFileCheck, over: bool) -> list[Path]:
    """Copy a file, unless an equal copy exists."""
    if not target.exists() or target.read_bytes() != file.read_bytes():
        writable.check(target, over)
        with atomic.replace_file(target) as copy:
            copy.write(file.read_bytes())
    return [target]
