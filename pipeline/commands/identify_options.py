"""What compare, diagnose, add and repair have in common: arguments, reading, the words on the screen."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from pipeline.commands.output import to_screen

if TYPE_CHECKING:
    from armdyn.effects.effect import Effect
    from armdyn.identify.compare import Comparison, FittedParameter
    from armdyn.identify.exam import Judge
    from armdyn.identify.localise import Place
    from armdyn.identify.rung import Rung
    from armdyn.identify.study import Study
    from armdyn.model_file import ModelFile

MOST_JOINTS = 3
"""Joints that are named in a line; of more only the number, as the JSON has them all."""

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
OutputOption = Annotated[
    Path | None, typer.Option("--output", help="Where the repaired model goes; over the old one when not given.")
]


class Given(NamedTuple):
    """What was read: the model's file, the effects to choose from, the study."""

    file: "ModelFile"
    catalogue: "tuple[Effect, ...]"
    study: "Study"


def read_study(
    model: Path,
    runs: list[Path],
    held_out: list[Path] | None,
    effects: Path | None,
    exam: list[Path] | None = None,
) -> Given:
    """Read everything that a study needs.

    Raises:
        InputError: something cannot be used.
    """
    from armdyn.effects.user import available, load_effects
    from armdyn.identify.study import Study
    from armdyn.model_file import read_model_file
    from armdyn.run import read_run

    own = load_effects(effects, stages=None) if effects is not None else ()
    file = read_model_file(model, own)
    catalogue = available(file.model, own, effects)
    training, others, last = ([read_run(file) for file in files or ()] for files in (runs, held_out, exam))
    return Given(file, catalogue, Study(file.model, training, others, catalogue, last))


def check_outputs(*files: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse early what could not be written at the end, or would destroy what was read.

    Args:
        files: to be written, None for none and ``-`` for standard output.
        inputs: recordings and models that are read.

    Raises:
        InputError: a directory is missing, or is given in place of a file; a file is to be written twice or was read.
    """
    from armdyn.errors import InputError

    taken = {file.resolve(): "an input" for file in inputs}
    for file in files:
        if file is None or file == Path("-"):
            continue
        if file.resolve() in taken:
            raise InputError(f"{file} is {taken[file.resolve()]}: choose another file to write")
        taken[file.resolve()] = "also to be written as something else"
        if file.is_dir():
            raise InputError(f"{file} is a directory: give the file to write")
        if not file.absolute().parent.is_dir():
            raise InputError(f"cannot write {file}: there is no directory {file.parent}; choose another place")


def inputs_of(model: Path, output: Path | None, runs: list[Path]) -> list[Path]:
    """What a repair must not write over: recordings, and the model unless it is named as the output, too."""
    over = output is not None and output.resolve() == model.resolve()
    return [*runs, *([] if over else [model])]


@contextmanager
def spinner() -> Iterator[Callable[[str], None]]:
    """Say on standard error what is going on, until the block ends."""
    from rich.console import Console

    with Console(stderr=True).status("reading") as status:
        yield status.update


def say_fit(found: "Comparison") -> None:
    """Print parameters and channels."""
    from rich.markup import escape
    from rich.table import Table

    from armdyn.preparation import of_all_runs, sentence

    console = to_screen()
    say_parameters(found.parameters)
    examined = any(c.exam_rmse is not None for c in found.channels.values())
    heads = ("channel", "noise", "rmse", "held out", *(("exam",) if examined else ()), "χ²/sample")
    channels = Table(*heads, box=None, header_style="dim")
    for name, c in found.channels.items():
        others = (c.held_out_rmse, c.exam_rmse) if examined else (c.held_out_rmse,)
        unseen = ["–" if error is None else f"{error:.4g} {c.unit}" for error in others]
        channels.add_row(
            name, f"{c.noise_std:.3g} {c.unit}", f"{c.rmse:.4g} {c.unit}", *unseen, f"{c.chi2_per_sample:.4g}"
        )
    console.print(channels)
    problem = found.fit.problem
    if done := sentence(of_all_runs(map(problem.model.preparations, problem.runs))):
        console.print(f"[dim]{done}[/]")
    if not found.intervals_hold:
        console.print(f"[yellow]{found.how_certain}[/]")
    for text in found.left_out:
        console.print(f"[yellow]{escape(text)}.[/]")
    for name in found.at_bound:
        console.print(f"[yellow]{escape(name)} ended on its physical bound: it may stand in for something else.[/]")
    for name in found.undetermined:
        console.print(f"[dim]{escape(name)} was not fitted: these runs say nothing about it.[/]")


def say_parameters(parameters: "Mapping[str, FittedParameter]") -> None:
    """Print values with their standard deviations."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("parameter", "value", "std", "unit", box=None, header_style="dim")
    for name, p in parameters.items():
        table.add_row(escape(name), f"{p.value:.6g}", "fixed" if p.std is None else f"{p.std:.2g}", p.unit)
    if parameters:
        to_screen().print(table)


def say_places(places: "Sequence[Place]", most: int = 6) -> None:
    """Print where the model fails."""
    console = to_screen()
    for place in places[:most]:
        run = f" in {place.run}" if place.run else ""
        console.print(
            f"  {place.channel}{run}: {place.against} {place.start:.3g} to {place.end:.3g} {place.unit}, "
            f"χ² per sample {place.chi2_per_sample:.3g}"
        )


def say_ladder(ladder: "tuple[Rung, ...]", units: "Mapping[str, str]", judges: "Sequence[Judge]") -> None:
    """Print the error falling; three channels or more, such as an arm's joints, as the root of their summed squares."""
    from rich.table import Column, Table

    from armdyn.identify.sentence import totals

    channels = list(ladder[0].rmse)
    together = len(channels) > 2
    unseen = ["held out", "exam"] if ladder[0].exam_rmse else ["held out"]
    heads = ["total rmse", *unseen] if together else [h for c in channels for h in (f"{c} rmse", *unseen)]
    columns = [Column(head, overflow="fold") for head in ("step", *heads, "χ²/sample", "BIC")]
    table = Table(*columns, box=None, header_style="dim")
    for rung in ladder:
        name = "+ " + " + ".join(rung.added) if rung.added else "as given" if not rung.removed else ""
        if rung.joints:
            few = len(rung.joints) <= MOST_JOINTS
            name += f" on {', '.join(rung.joints)}" if few else f" on {len(rung.joints)} joints"
        name += "".join(f" − {removed}" for removed in rung.removed)
        name += f" (or {', '.join(rung.tied_with)})" if rung.tied_with else ""
        kinds = (rung.rmse, rung.held_out_rmse, rung.exam_rmse)[: 1 + len(unseen)]
        if together:
            sums = [totals(errors, units) for errors in kinds]
            cells = [", ".join(f"{e:.4g} {unit}" for unit, e in by_unit.items()) or "–" for by_unit in sums]
        else:
            errors = [errors.get(channel) for channel in channels for errors in kinds]
            cells = [f"{e:.4g}" if e is not None else "–" for e in errors]
        table.add_row(name, *cells, f"{rung.chi2_per_sample:.4g}", f"{rung.bic:.6g}")
    console = to_screen()
    console.print(table)
    for judge in judges:
        console.print(f"[dim]{judge.value}[/]")
