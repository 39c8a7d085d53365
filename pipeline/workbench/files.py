"""Files of a page: files that are dropped onto it, and files that a user saves from it.

A dropped file goes through the same door as on the command line; kept are the model file, a report, and the model for
other tools.
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

from armdyn.checked_study import CheckedStudy
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.model_file import ModelFile, base_pendulum, read_model_file, write_model_file
from armdyn.quoting import command_text
from armdyn.read_files import may_replace
from armdyn.run import Run, read_run, write_run_csv
from ik.child_processes import is_running
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.workbench.bench import Workbench

PREFIX = "armdyn-page-"


def new_folder() -> tempfile.TemporaryDirectory[str]:
    """New folder for the files of one page while it is open."""
    return tempfile.TemporaryDirectory(prefix=f"{PREFIX}{os.getpid()}-", ignore_cleanup_errors=True)


def remove_folders() -> None:
    """Remove the folders of all pages of this process."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}{os.getpid()}-*"):
        shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned() -> None:
    """Remove the folders of workbenches that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*-*"):
        number = folder.name.removeprefix(PREFIX).partition("-")[0]
        if number.isdecimal() and not is_running(int(number)):
            shutil.rmtree(folder, ignore_errors=True)


class Writable:
    """Places where pages may write: below the folder in which the workbench was started, and over their own files.

    Args:
        folder: folder in which the workbench was started.
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
            InputError: the file is elsewhere, exists already, or was changed since a page wrote it.
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
            raise InputError(f"{file} is not as a page of this workbench left it: choose another name")
        may_replace(target)

    def note(self, file: Path) -> None:
        """Remember that a page has written this file."""
        self._written[file.resolve()] = _digest(file)


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def is_temporary(file: Path) -> bool:
    """Whether a file lies in the folder of a page, which is removed with it."""
    return any(parent.name.startswith(PREFIX) for parent in file.resolve().parents)


class Dropped(NamedTuple):
    """A dropped file and its kind.

    Attributes:
        kind: "run", "model" or "sidecar".
        path: file that is used from now on.
        said: sentence for a person.
    """

    kind: str
    path: Path
    said: str


def place_for(folder: Path, name: str) -> Path:
    """Path of a dropped file: its own name, without parts that would lead to another folder.

    Raises:
        InputError: the name is empty after that.
    """
    plain = re.sub(r"[^\w .+()-]", "_", Path(name.replace("\\", "/")).name).strip(" .")
    if not plain:
        raise InputError(f"{name!r:.60} is no name of a file: rename it")
    return folder / plain


def read_dropped(path: Path, joints: Sequence[str] = ()) -> Dropped:
    """Read a dropped file, and determine its kind.

    Args:
        path: place of the file.
        joints: names of the arm's joints, where there is one, for columns that are only numbered.

    Raises:
        InputError: the file cannot be used; the message is one sentence.
    """
    suffix = path.suffix.lower()
    if suffix in (".urdf", ".xml"):
        return _arm_of(path)
    if suffix == ".toml":
        return _toml(path)
    return _recording(path, joints)


def pendulum(folder: Path, mass: str, length: str) -> Path:
    """Write the model file of a new pendulum.

    Args:
        folder: folder of the page.
        mass: mass, such as "80 g +/- 0.4 g"; empty where it is not known.
        length: length, such as "0.368 m +/- 1 mm"; empty where it is not known.

    Raises:
        InputError: a value or unit cannot be read.
    """
    known = {name: text.strip() for name, text in (("mass", mass), ("length", length)) if text.strip()}
    return _write_model(folder / "pendulum.toml", ModelFile(base_pendulum(known), {}))


def known_arm(folder: Path, robot: str) -> Path:
    """Write the model file of an arm that is known by name.

    Raises:
        InputError: no arm has this name.
    """
    from armdyn.arm.model import arm_model

    made = arm_model(robot=robot)
    return _write_model(folder / f"{robot}.toml", ModelFile(made, {"robot": robot, "joints": list(made.joints)}))


def _arm_of(path: Path) -> Dropped:
    from armdyn.arm.described import with_described_effects
    from armdyn.arm.model import arm_model

    made = with_described_effects(arm_model(path))
    said = [f"{path.name}: an arm with the joints {', '.join(made.joints)}"]
    said += [*made.arm.robot.warnings, *made.arm.robot.notes]
    model = _write_model(path.with_suffix(".toml"), ModelFile(made, {"joints": list(made.joints)}))
    return Dropped("model", model, ". ".join(said))


def _toml(path: Path) -> Dropped:
    from armdyn.recording.sidecar import read_sidecar
    from armdyn.toml_file import read_toml

    table = read_toml(path)
    if "base" in table:
        model: Model = read_model_file(path).model
        effects = ", ".join(effect.label for effect in model.named_effects)
        return Dropped(
            "model", path, f"{path.name}: a model of base '{model.base}'" + (f" with {effects}" * bool(effects))
        )
    read_sidecar(path)
    return Dropped("sidecar", path, f"{path.name}: describes the recording of the same name")


def _recording(path: Path, joints: Sequence[str]) -> Dropped:
    """A run as it is, or one made of foreign columns whose names, units and ranges suggest their meaning."""
    try:
        run = read_run(path)
        return Dropped("run", path, f"{path.name}: {_contents(run)}")
    except InputError as error:
        own = error
    from pipeline.imports import read_foreign
    from pipeline.imports.conversion import imported
    from pipeline.imports.guess import guess_map, known_columns
    from pipeline.imports.joints import Joints

    try:
        foreign = read_foreign(path)[0]
        try:
            mapping = known_columns(foreign)
        except InputError:
            mapping = guess_map([foreign], Joints(tuple(joints)))
        run = imported(foreign, mapping).run
    except InputError as error:
        # For a run of our own the message says what is wrong; for another format it says what is missing.
        raise (own if path.suffix.lower() == ".csv" and "[" in str(own) else error) from error
    target = path.with_name(f"{path.stem}.csv" if path.suffix.lower() != ".csv" else f"{path.stem}_run.csv")
    write_run_csv(run, target)
    columns = ", ".join(f"{column} as {entry.channel}" for column, entry in list(mapping.entries.items())[:4])
    more = f" and {len(mapping.entries) - 4} more" if len(mapping.entries) > 4 else ""
    doubts = list(mapping.asked.values())
    asked = f"; not sure of {len(doubts)}, such as {doubts[0]}" if doubts else ""
    return Dropped("run", target, f"{path.name}: taken as {_contents(run)}, with {columns}{more}{asked}")


def _contents(run: Run) -> str:
    seconds = max(float(channel.time[-1]) for channel in run.channels.values())
    kinds = ", ".join(dict.fromkeys(name.partition(".")[0] for name in run.channels))
    joints = f" of {len(run.joints)} joints" if run.joints else ""
    return f"{kinds}{joints}, {seconds:.1f} s"


def _write_model(path: Path, file: ModelFile) -> Path:
    write_model_file(path, file)
    return path


def add_laws(folder: Path, own: Path | None, text: str) -> Path:
    """Write a file of effects with discovered laws, after the effects of the user's file, if any.

    Args:
        folder: folder of the page.
        own: the user's file; None for none.
        text: text of a file of effects.
    """
    before = "" if own is None else own.read_text(encoding="utf-8") + "\n\n"
    target = folder / "discovered.py"
    target.write_text(before + text, encoding="utf-8")
    return target


class Kept(NamedTuple):
    """Files that were saved from a page.

    Attributes:
        files: in the order in which they were written.
        sentence: sentence on the repair, with its error.
        notes: what a format cannot hold, and whether it is therefore not written.
        next_step: text of a useful command.
    """

    files: tuple[Path, ...]
    sentence: str
    notes: tuple[str, ...]
    next_step: str


def keep(
    opened: ModelAndRunInputs,
    given: CheckedStudy,
    bench: Workbench,
    effects: Sequence[str],
    model: Path,
    report: Path | None = None,
    exported: Path | None = None,
    *,
    writable: Writable,
    over: bool = False,
) -> Kept:
    """Refit with effects one after the other, and write the files that `add` and `export` would write.

    Args:
        opened: opened input files.
        given: model file and catalogue.
        bench: the study and the effects that can be ticked.
        effects: labels of the ticked effects.
        model: model file to write.
        report: report to write; None for none.
        exported: file for another tool, whose ending gives the format; None for none.
        writable: places where files may be written.
        over: whether files that a page has written may be replaced.

    Raises:
        InputError: a file cannot be written, or exists already.
        TaskFailedError: the fit failed.
    """
    from armdyn.document import NextStep
    from armdyn.identify.repair import require_found
    from pipeline.answers import history_entries
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
    found = require_found(given.add(bench.effects_of(effects)))
    kept, copied = _with_its_urdf(found.model, model, writable, over)
    if opened.effects is not None and is_temporary(opened.effects):
        laws = model.with_name(f"{model.stem}_effects.py")
        copied += _copied(opened.effects, laws, writable, over)
        opened = replace(opened, effects=laws)
    file = ModelFile(kept, given.known.file.description, (*given.known.file.history, *history_entries(study, found)))
    write_model_file(model, file)
    files, notes = [model, *copied], list[str]()
    command = replace(opened, model=model).command("compare", "--report", "compare.html")
    if report is not None:
        write_page(repair_report(study, found, [NextStep("hold it against runs", command)]), report)
        files.append(report)
    if exported is not None:
        written = write_export(file, exported, model.name)
        notes += written.notes
        if written.missing is not None:
            notes.append(written.missing.sentence)
        if written.refused:
            again = command_text("export", model, "--output", exported, "--incomplete")
            notes.append(f"{exported} is not written; to write it all the same: {again}")
        else:
            files.append(exported)
    for one in files:
        writable.note(one)
    return Kept(tuple(files), found.sentence, tuple(notes), command)


def _with_its_urdf(found: Model, model: Path, writable: Writable, over: bool) -> tuple[Model, list[Path]]:
    """The model, with a dropped URDF copied beside its file, because a page's folder is temporary."""
    arm = found.as_arm()
    if arm is None or arm.arm.file is None or not is_temporary(arm.arm.file):
        return found, []
    target = model.parent / arm.arm.file.name
    copied = _copied(arm.arm.file, target, writable, over)
    return replace(arm, arm=replace(arm.arm, file=target.resolve())), copied


def _copied(file: Path, target: Path, writable: Writable, over: bool) -> list[Path]:
    """Copy of a page's file beside the model; an existing equal copy is kept."""
    if not target.exists() or target.read_bytes() != file.read_bytes():
        writable.check(target, over)
        shutil.copyfile(file, target)
    return [target]
