"""What a person keeps of the bench: the model file, a report, the model for other tools."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.model import Model
from pipeline.commands.identify import Given, Inputs
from pipeline.workbench.bench import Atom, Bench


@dataclass(frozen=True)
class Kept:
    """What was written.

    Attributes:
        files: in the order in which they were written.
        sentence: of the repair, with its error.
        notes: what a format cannot hold.
        next_step: a command.
    """

    files: tuple[Path, ...]
    sentence: str
    notes: tuple[str, ...]
    next_step: str


def keep(
    opened: Inputs,
    given: Given,
    bench: Bench,
    effects: Sequence[Atom],
    model: Path,
    report: Path | None = None,
    exported: Path | None = None,
    *,
    force: bool = False,
) -> Kept:
    """Refit with these effects one after the other, and write what `add` and `export` would.

    Args:
        opened: that were opened.
        given: model file and catalogue.
        bench: the study and what can be ticked.
        effects: that are ticked.
        model: file to write.
        report: likewise; None for none.
        exported: likewise, its ending says what it is; None for none.
        force: write over what is there.

    Raises:
        InputError: a file cannot be written, or is there.
    """
    from armdyn.identify.repair import add
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import history_entries
    from pipeline.commands.export import write_export
    from pipeline.commands.output import check_outputs, free_to_write
    from pipeline.report.page import NextStep
    from pipeline.report.repair import repair_report

    if model.suffix.lower() != ".toml":
        raise InputError(f"{model}: end the name of a model file in .toml")
    study = bench.study
    check_outputs(model, report, exported, inputs=opened.recordings)
    for file in (model, report, exported):
        if file is not None:
            free_to_write(file, force)
    found = add(study, bench.effects_of(effects))
    kept, copied = _with_its_urdf(found.model, model, force)
    write_model_file(
        model, ModelFile(kept, given.file.description, (*given.file.history, *history_entries(study, found)))
    )
    files, notes = [model, *copied], []
    command = opened._replace(model=model).command("compare", "--report", "compare.html")
    if report is not None:
        repair_report(study, found, next_steps=[NextStep("hold it against runs:", command)]).write(report)
        files.append(report)
    if exported is not None:
        notes = write_export(ModelFile(kept, given.file.description), exported, model.name)
        files.append(exported)
    return Kept(tuple(files), found.sentence, tuple(notes), command)


def _with_its_urdf(found: Model, model: Path, force: bool) -> tuple[Model, list[Path]]:
    """The model, with a URDF that was dropped onto the page copied beside its file: a page's folder does not last."""
    from pipeline.commands.output import free_to_write
    from pipeline.workbench.uploads import is_passing

    if not isinstance(found, ArmModel) or found.arm.file is None or not is_passing(found.arm.file):
        return found, []
    target = model.parent / found.arm.file.name
    if not target.exists() or target.read_bytes() != found.arm.file.read_bytes():
        free_to_write(target, force)
        shutil.copyfile(found.arm.file, target)
    return replace(found, arm=replace(found.arm, file=target.resolve())), [target]
