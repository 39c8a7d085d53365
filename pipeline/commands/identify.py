"""`armdyn compare`, `diagnose`, `add` and `repair`: a model against recordings."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from pipeline.commands.output import JsonOption, answered, check_outputs, command_line, spinner

if TYPE_CHECKING:
    from armdyn.effects.effect import Effect
    from armdyn.identify.repair import Repair
    from armdyn.identify.study import Study
    from armdyn.inspection.check import Inspection
    from armdyn.model import Model
    from armdyn.model_file import ModelFile

ModelArgument = Annotated[Path, typer.Argument(metavar="M.toml", help="Model file.")]
RunsArgument = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings to fit: CSV or MCAP.")]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--held-out",
        help="A recording that takes part in choosing effects and never in a fit; give the option once for each.",
    ),
]
ExamOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--exam",
        help="A recording that takes part in nothing: its error is computed at the very end. Give the option once for "
        "each.",
    ),
]
EffectsOption = Annotated[Path | None, typer.Option("--effects", help="Python file with effects of your own.")]
ReportOption = Annotated[Path | None, typer.Option("--report", help="Write one offline HTML file.")]
TrustOption = Annotated[
    bool, typer.Option("--trust-data", help="Go on where 'armdyn inspect' finds a recording wrong.")
]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "--out", help="Where the repaired model goes; over the old one when not given."),
]


REPAIRED = ("--output", "repaired.toml", "--report", "repair.html")
"""Where the files of a repair go that is proposed."""


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    for command in (compare, diagnose, add, repair):
        app.command()(command)


class Inputs(NamedTuple):
    """Files that a command reads, as its arguments name them."""

    model: Path
    runs: list[Path]
    held_out: list[Path] | None
    exam: list[Path] | None
    effects: Path | None
    trust: bool = False

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
        words += ["--trust-data"] if self.trust and name in ("compare", "diagnose", "repair") else []
        return shlex.join([*words, *options])

    def read(self, adding: str | None = None) -> "Given":
        """Read everything that a study needs, and ask whether the recordings are what they say they are.

        Args:
            adding: name of an effect that the model is about to get.

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

        own = load_effects(self.effects, stages=None) if self.effects is not None else ()
        file = read_model_file(self.model, own)
        catalogue = available(file.model, own, self.effects)
        runs, held_out, exam = (
            [read_run(path) for path in paths or ()] for paths in (self.runs, self.held_out, self.exam)
        )
        for run in (*runs, *held_out, *exam):
            check_run(file.model, run, [find(adding, catalogue)] if adding is not None else ())
        found = inspected([*runs, *held_out, *exam], file.model, catalogue).naming(self.model)
        if not self.trust:
            require_usable(found)
        return Given(file, catalogue, Study(file.model, runs, held_out, catalogue, exam), found, self.trust)


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
    from armdyn.errors import WrongRecordingError

    try:
        yield
    except WrongRecordingError as error:
        from pipeline.answers_inspection import inspection_answer
        from pipeline.commands.inspecting import say_inspection

        found = error.inspection
        if answered(json_file, lambda: inspection_answer(found)):
            say_inspection(found)
            typer.echo("No effect is named while a recording is wrong; --trust-data goes on regardless.")
        raise typer.Exit(1) from error


def compare(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Fit what is free, and say how well the model does and where it fails."""
    from armdyn.identify.compare import compare as hold_against
    from armdyn.inspection.plausible import compared_model
    from pipeline.answers import comparison_answer
    from pipeline.commands.identify_text import say_comparison

    inputs = Inputs(model, runs, held_out, exam, effects, trust_data)
    inputs.check(report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        say("fitting")
        found = hold_against(given.study)
        given.require_plausible(compared_model(given.study.model, found))
        if report is not None:
            from pipeline.report.fit import comparison_report

            comparison_report(given.study, found, command_line()).write(report)
    if answered(json_file, lambda: {**comparison_answer(given.study, found), **checked(given)}):
        say_comparison(found)
        say_report(report)
        if not found.explained:
            typer.echo(f"what is missing: {inputs.command('repair', *REPAIRED)}")


def diagnose(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Find out which physical effect is missing, with an honest verdict."""
    from armdyn.identify.diagnose import diagnose as find_missing
    from armdyn.identify.repair import fitted_model
    from pipeline.answers import diagnosis_answer
    from pipeline.commands.identify_text import say_diagnosis

    inputs = Inputs(model, runs, held_out, exam, effects, trust_data)
    inputs.check(report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        found = find_missing(given.study, say)
        given.require_plausible(fitted_model(given.study, found.search.last))
        if report is not None:
            from pipeline.report.repair import diagnosis_report

            diagnosis_report(given.study, found, command_line()).write(report)
    if answered(json_file, lambda: {**diagnosis_answer(given.study, found), **checked(given)}):
        say_diagnosis(found)
        say_report(report)
        moved = all("gripper_x" in run.channels for run in given.study.runs)
        if found.remedies and given.study.model.base == "pendulum" and moved:
            typer.echo(f"tell them apart: {inputs.command('next', '--output', 'motion.csv', '--report', 'next.html')}")
        if found.suspects:
            typer.echo(f"add it: {inputs.command('repair', *REPAIRED)}")


def add(
    model: ModelArgument,
    effect: Annotated[str, typer.Argument(metavar="EFFECT[:JOINT,...]", help="Name of the effect, with its joints.")],
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    output: OutputOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Add an effect to a model and refit."""
    from armdyn.effects.catalogue import find
    from armdyn.identify.repair import add as extend

    inputs = Inputs(model, runs, held_out, exam, effects, trust_data)
    inputs.check_repair(output, report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read(adding=effect)
        wanted = find(effect, given.catalogue)
        given.file.model.with_effect(wanted)  # refuses an effect that does not fit before anything is fitted
        say("fitting")
        found = extend(given.study, [wanted])
        given.require_plausible(found.model)
    _conclude(inputs, given, found, output or model, report, json_file)


def repair(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    output: OutputOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    trust_data: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Add the effects that are missing, one after the other, and watch the error fall."""
    from armdyn.identify.repair import repair as mend

    inputs = Inputs(model, runs, held_out, exam, effects, trust_data)
    inputs.check_repair(output, report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        found = mend(given.study, say)
        given.require_plausible(found.model)
    _conclude(inputs, given, found, output or model, report, json_file)


def _conclude(
    inputs: Inputs, given: Given, found: "Repair", output: Path, report: Path | None, json_file: Path | None
) -> None:
    """Write the repaired model, its report and its answer, and print how the error fell."""
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import history_entries, repair_answer
    from pipeline.commands.identify_text import say_repair

    if report is not None:
        from pipeline.report.page import NextStep
        from pipeline.report.repair import repair_report

        steps = [
            NextStep(f"{what}:", command) for what, command in next_steps(given.study, output, inputs.effects).items()
        ]
        repair_report(given.study, found, command_line(), steps).write(report)
    history = (*given.file.history, *history_entries(given.study, found))
    over = " (over the earlier one)" if output.exists() else ""
    write_model_file(output, ModelFile(found.model, given.file.description, history))
    if answered(json_file, lambda: {**repair_answer(found), **checked(given)}):
        say_repair(found, given.study.judges)
        typer.echo(f"written to {output}{over}")
        say_report(report)
        for what, command in next_steps(given.study, output, inputs.effects).items():
            typer.echo(f"{what}: {command}")


def checked(given: Given) -> dict[str, Any]:
    """What every answer says of its recordings."""
    from pipeline.answers_inspection import checks_answer

    return {"recording_checks": checks_answer(given.inspection.checks)}


def say_report(report: Path | None) -> None:
    """Print where the report went."""
    if report is not None:
        typer.echo(f"report {report}")


def next_steps(study: "Study", output: Path, effects: Path | None = None) -> dict[str, str]:
    """Commands that use a repaired model, by what they do; its own effects are in the file `effects`."""
    own = ["--effects", str(effects)] if effects is not None else []
    kind = {"pendulum": ".py", "arm": ".xml"}.get(study.model.base, ".json")
    export = shlex.join(["armdyn", "export", str(output), *own, "--output", f"{output.stem}{kind}"])
    if study.model.base == "pendulum":
        return {
            "swing with it": shlex.join(["armdyn", "trial", "--model", str(output), *own]),
            "take it elsewhere": export,
        }
    return {"take it elsewhere": export}
