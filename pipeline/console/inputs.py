"""The model and the recordings that a command is given, read together and asked whether they are what they say."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from pipeline.console.options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    ModelArgument,
    RunsArgument,
    TrustOption,
)
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import finish

if TYPE_CHECKING:
    from armdyn.effects.effect import Effect
    from armdyn.identify.study import Study
    from armdyn.inspection.check import Inspection
    from armdyn.model import Model
    from armdyn.model_file import ModelFile


@dataclass(frozen=True)
class Inputs:
    """What a command that holds a model against recordings reads: its arguments and options."""

    model: ModelArgument
    runs: RunsArgument
    held_out: HeldOutOption = None
    exam: ExamOption = None
    effects: EffectsOption = None
    trust_data: TrustOption = False

    def check(self, report: Path | None, json_file: Path | None) -> None:
        """Refuse outputs that cannot be written or would replace an input."""
        check_outputs(report, json_file, inputs=[self.model, *self.recordings])

    def check_repair(self, output: Path | None, report: Path | None, json_file: Path | None) -> None:
        """The same for a command that writes a model, which may replace the old one where it is named as the output."""
        over = output is not None and output.resolve() == self.model.resolve()
        inputs = [*self.recordings, *([] if over else [self.model])]
        check_outputs(output, report, json_file, inputs=inputs)

    @property
    def recordings(self) -> list[Path]:
        """Every recording."""
        return [*self.runs, *(self.held_out or ()), *(self.exam or ())]

    def command(self, name: str, *options: str) -> str:
        """Another command on the same files."""
        words = ["armdyn", name, str(self.model), *map(str, self.runs)]
        for option, paths in (("--held-out", self.held_out), ("--exam", self.exam)):
            words += [word for path in paths or () for word in (option, str(path))]
        words += ["--effects", str(self.effects)] if self.effects is not None else []
        words += ["--trust-data"] if self.trust_data and name in ("compare", "diagnose", "repair") else []
        return shlex.join([*words, *options])

    def read(self, adding: str | None = None, *, choosing: bool = True) -> "Given":
        """Read everything that a study needs, and ask whether the recordings are what they say they are.

        Args:
            adding: name of an effect that the model is about to get.
            choosing: whether effects are chosen from the catalogue; a study without it is faster.

        Raises:
            InputError: something cannot be used.
            WrongRecordingError: a recording is not what it says it is, and is not trusted.
        """
        from armdyn.effects.catalogue import find
        from armdyn.effects.user import available, load_effects
        from armdyn.identify.study import Study
        from armdyn.inspection.inspect import inspected, require_usable
        from armdyn.model_file import read_model_file
        from armdyn.run import read_run
        from armdyn.run_checks import check_run

        own = load_effects(self.effects, stages=None)
        file = read_model_file(self.model, own)
        catalogue = available(file.model, own, self.effects)
        runs, held_out, exam = (
            [read_run(path) for path in paths or ()] for paths in (self.runs, self.held_out, self.exam)
        )
        for run in (*runs, *held_out, *exam):
            check_run(file.model, run, [find(adding, catalogue)] if adding is not None else ())
        found = inspected([*runs, *held_out, *exam], file.model, catalogue).naming(self.model)
        if not self.trust_data:
            require_usable(found)
        study = Study(file.model, runs, held_out, catalogue if choosing else (), exam)
        return Given(file, catalogue, study, found, self.trust_data)


@dataclass(frozen=True)
class UnexaminedInputs(Inputs):
    """The same for a command that never says how large an error is, and has no use for ``--exam``."""

    exam: list[Path] | None = field(default=None, init=False)


class Given(NamedTuple):
    """What was read: the model's file, the effects to choose from, the study, what was found in the recordings."""

    file: "ModelFile"
    catalogue: "tuple[Effect, ...]"
    study: "Study"
    inspection: "Inspection"
    trust: bool

    def require_plausible(self, model: "Model") -> None:
        """Refuse what was fitted where nothing can have such values, unless the data are trusted.

        Raises:
            WrongRecordingError: has the checks.
        """
        from armdyn.inspection.plausible import require_plausible

        if not self.trust:
            require_plausible(model, self.inspection.runs, self.file.model)


@contextmanager
def stopped_if_wrong(json_file: Path | None) -> "Iterator[None]":
    """End a command with exit status 1 where its recordings are not what they say they are; no effect is named."""
    from armdyn.inspection.check import WrongRecordingError

    try:
        yield
    except WrongRecordingError as error:
        from pipeline.answers import inspection_answer
        from pipeline.report.inspection import inspection_document

        note = "No effect is named while a recording is wrong; --trust-data goes on regardless."
        found = error.inspection
        finish(replace(inspection_document(found), notes=[note]), lambda: inspection_answer(found), json_file)
        raise typer.Exit(1) from error


def checked(given: Given) -> dict[str, Any]:
    """What every answer says of its recordings."""
    from pipeline.answers import checks_answer

    return {"recording_checks": checks_answer(given.inspection.checks)}
