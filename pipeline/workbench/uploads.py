"""Files that are dropped onto the page: each goes through the same door as on the command line."""

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.model_file import ModelFile, base_pendulum, write_model_file
from armdyn.run import Run, read_run, write_run_csv

PREFIX = "armdyn-page-"
LARGEST = 500_000_000
"""bytes of one file."""


def new_folder() -> tempfile.TemporaryDirectory[str]:
    """Where the files of one page are kept while it is open."""
    return tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True)


def is_passing(file: Path) -> bool:
    """Whether a file lies in the folder of a page, which is removed with it."""
    return any(parent.name.startswith(PREFIX) for parent in file.resolve().parents)


@dataclass(frozen=True)
class Dropped:
    """What a file turned out to be.

    Attributes:
        kind: "run", "model" or "sidecar".
        path: that is used from now on.
        said: for a person.
    """

    kind: str
    path: Path
    said: str


def place_for(folder: Path, name: str) -> Path:
    """Where a dropped file goes: its own name, without anything that would lead elsewhere.

    Raises:
        InputError: nothing is left of the name.
    """
    plain = re.sub(r"[^\w .+()-]", "_", Path(name.replace("\\", "/")).name).strip(" .")
    if not plain:
        raise InputError(f"{name!r:.60} is no name of a file: rename it")
    return folder / plain


def taken_in(path: Path, joints: Sequence[str] = ()) -> Dropped:
    """Read a dropped file, and say what it is.

    Args:
        path: where it was put.
        joints: of the arm, where there is one: columns that are only numbered get their names.

    Raises:
        InputError: it cannot be used, in one sentence.
    """
    suffix = path.suffix.lower()
    if suffix in (".urdf", ".xml"):
        return _arm_of(path)
    if suffix == ".toml":
        return _toml(path)
    return _recording(path, joints)


def pendulum(folder: Path, mass: str, length: str) -> Path:
    """The file of a new pendulum.

    Args:
        folder: of the page.
        mass: such as "80 g +/- 0.4 g"; empty where it is not known.
        length: such as "0.368 m +/- 1 mm"; likewise.

    Raises:
        InputError: a value or unit cannot be read.
    """
    known = {name: text.strip() for name, text in (("mass", mass), ("length", length)) if text.strip()}
    return _written(folder / "pendulum.toml", ModelFile(base_pendulum(known), {}))


def known_arm(folder: Path, robot: str) -> Path:
    """The file of an arm that is known by name.

    Raises:
        InputError: there is none of this name.
    """
    from armdyn.arm.model import arm_model

    made = arm_model(robot=robot)
    return _written(folder / f"{robot}.toml", ModelFile(made, {"robot": robot, "joints": list(made.joints)}))


def _arm_of(path: Path) -> Dropped:
    from armdyn.arm.model import arm_model

    made = arm_model(path)
    model = _written(path.with_suffix(".toml"), ModelFile(made, {"joints": list(made.joints)}))
    return Dropped("model", model, f"{path.name}: an arm with the joints {', '.join(made.joints)}")


def _toml(path: Path) -> Dropped:
    from armdyn.model_file import read_model_file
    from armdyn.sidecar import read_sidecar
    from urdf.table_file import TableFileError, read_table

    try:
        table = read_table(path)[1]
    except TableFileError as error:
        raise InputError(f"{path.name}: {error}") from error
    if "base" in table:
        model: Model = read_model_file(path).model
        effects = ", ".join(effect.label for effect in model.effects)
        return Dropped(
            "model", path, f"{path.name}: a model of base '{model.base}'" + (f" with {effects}" * bool(effects))
        )
    read_sidecar(path)
    return Dropped("sidecar", path, f"{path.name}: describes the recording of the same name")


def _recording(path: Path, joints: Sequence[str]) -> Dropped:
    """A run as it is, else one made of foreign columns as their names, units and ranges suggest."""
    try:
        run = read_run(path)
        return Dropped("run", path, f"{path.name}: {_contents(run)}")
    except InputError as error:
        own = error
    from pipeline.imports.conversion import imported
    from pipeline.imports.foreign import read_foreign
    from pipeline.imports.guess import guessed
    from pipeline.imports.mapping import known_columns

    try:
        foreign = read_foreign(path)[0]
        try:
            mapping = known_columns(foreign)
        except InputError:
            mapping = guessed(foreign, joints)
        run = imported(foreign, mapping)
    except InputError as error:
        # Who meant a run of our own is told what is wrong with it, whoever brings another format what it lacks.
        raise (own if path.suffix.lower() == ".csv" and "[" in str(own) else error) from error
    target = path.with_name(f"{path.stem}.csv" if path.suffix.lower() != ".csv" else f"{path.stem}_run.csv")
    write_run_csv(run, target)
    columns = ", ".join(f"{column} as {entry.channel}" for column, entry in list(mapping.entries.items())[:4])
    more = f" and {len(mapping.entries) - 4} more" if len(mapping.entries) > 4 else ""
    return Dropped("run", target, f"{path.name}: taken as {_contents(run)}, with {columns}{more}")


def _contents(run: Run) -> str:
    seconds = max(float(channel.time[-1]) for channel in run.channels.values())
    kinds = ", ".join(dict.fromkeys(name.partition(".")[0] for name in run.channels))
    joints = f" of {len(run.joints)} joints" if run.joints else ""
    return f"{kinds}{joints}, {seconds:.1f} s"


def _written(path: Path, file: ModelFile) -> Path:
    write_model_file(path, file)
    return path
