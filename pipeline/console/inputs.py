"""Read the model and the recordings of a command, and inspect the recordings for mistakes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armdyn.quoting import shell_quoted_command
from armdyn.read_files import allow_overwrite
from pipeline.console.options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    JsonOption,
    ModelArgument,
    ReportOption,
    RunsArgument,
    TrustOption,
)
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import ProgressDisplay, finish_command, progress_display

if TYPE_CHECKING:
    from armdyn.checked_study import CheckedStudy
    from armdyn.document import Document


@dataclass(frozen=True)
class ModelAndRunInputs:
    """Arguments and options of a command that compares a model with recordings."""

    model: ModelArgument
    runs: RunsArgument
    held_out: HeldOutOption = None
    exam: ExamOption = None
    effects: EffectsOption = None
    trust_data: TrustOption = False

    @property
    def recordings(self) -> list[Path]:
        """Files of all recordings of the command: training, held-out and exam runs."""
        return [*self.runs, *(self.held_out or ()), *(self.exam or ())]

    def proposed_command(self, name: str, *options: str) -> str:
        """Text of a command with these input files, to be proposed to the user as a next step.

        Args:
            name: name of the command.
            options: further words of the command.
        """
        words: list[object] = [self.model, *self.runs]
        for option, paths in (("--held-out", self.held_out), ("--exam", self.exam)):
            words += [word for path in paths or () for word in (option, path)]
        words += ["--effects", self.effects] if self.effects is not None else []
        words += ["--trust-data"] if self.trust_data and name in ("compare", "diagnose", "repair") else []
        return shell_quoted_command(name, *words, *options)

    def read(self, adding: str = "", *, choosing: bool = True) -> "CheckedStudy":
        """Read the model and the recordings of a study, and check the recordings for mistakes.

        Args:
            adding: names of effects that will be added to the model.
            choosing: whether effects will be chosen from the catalogue; False is faster.

        Raises:
            InputError: the model or a recording cannot be used.
            WrongRecordingError: a mistake was found in a recording, and ``--trust-data`` was not given.
        """
        from armdyn.checked_study import CheckedStudy, ModelWithCatalogue

        return CheckedStudy.of(
            ModelWithCatalogue.of(self.model, self.effects), self.runs, self.held_out or (), self.exam or (),
            effects=None if choosing else (), adding=adding, trusted=self.trust_data,
        )  # fmt: skip


@dataclass(frozen=True)
class StudyInputs(ModelAndRunInputs):
    """Arguments and options of a command that compares a model with recordings and writes a report and JSON."""

    report: ReportOption = None
    json_file: JsonOption = None

    @contextmanager
    def begin(
        self, output: Path | None = None, *, over_model: bool = False, adding: str = "", choosing: bool = True
    ) -> "Iterator[tuple[CheckedStudy, ProgressDisplay]]":
        """Check the output files, read the inputs, and run the ``with`` block with a progress display.

        Args:
            output: file that the command writes.
            over_model: whether the output may replace the model's own file.
            adding: names of effects that will be added to the model.
            choosing: whether effects will be chosen from the catalogue.

        Yields:
            The study, and the function that shows the progress.

        Raises:
            InputError: an output cannot be written or would replace an input, or an input cannot be used.
            typer.Exit: a mistake was found in a recording; it was printed.
        """
        over = over_model and (output is None or output.resolve() == self.model.resolve())
        kept = [] if over and output is not None else [self.model]
        own = [self.effects] if self.effects is not None else []
        check_outputs(output, self.report, self.json_file, inputs=[*kept, *self.recordings, *own])
        if over:
            allow_overwrite(self.model)
        with exit_on_wrong_recording(self.json_file), progress_display() as say:
            given = self.read(adding, choosing=choosing)
            check_outputs(output, self.report, self.json_file)  # the names in the inputs are known now
            yield given, say

    def finish(
        self,
        given: "CheckedStudy",
        document: "Document",
        answer: Callable[[], dict[str, Any]],
        page: "Callable[[], Document]",
        written: Sequence[str] = (),
        *,
        failed: bool = False,
    ) -> None:
        """Print the answer and write report and JSON, to which the mistakes in the recordings are added.

        Args:
            given: the study of the command.
            document: answer for the screen.
            answer: function that returns the JSON output.
            page: function that returns the document for the report.
            written: a sentence for each other file that was written.
            failed: whether the command ends with exit status 1.
        """
        from pipeline.answers import recording_checks_json

        def whole() -> dict[str, Any]:
            checks = [*given.inspection.checks, *given.exam_inspection.checks]
            return {**answer(), "recording_checks": recording_checks_json(checks)}

        finish_command(document, whole, self.json_file, self.report, page, written, failed=failed)


@dataclass(frozen=True)
class StudyInputsWithoutExam(StudyInputs):
    """Arguments and options of a command that compares a model with recordings, without the option ``--exam``."""

    exam: list[Path] | None = field(default=None, init=False)


@contextmanager
def exit_on_wrong_recording(json_file: Path | None) -> "Iterator[None]":
    """Print the mistakes and end the command with exit status 1 if the ``with`` block raises `WrongRecordingError`."""
    from armdyn.inspection.check import WrongRecordingError

    try:
        yield
    except WrongRecordingError as error:
        from pipeline.answers import inspection_json
        from pipeline.report.inspection import inspection_document

        note = "No effect is named while a recording is wrong; --trust-data goes on regardless."
        found = error.inspection
        finish_command(replace(inspection_document(found), notes=[note]), lambda: inspection_json(found), json_file)
        raise typer.Exit(1) from error
