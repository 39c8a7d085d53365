"""What compare, diagnose, add and repair print."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import typer

from pipeline.console.screen import plain_table, to_screen

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange, LinkQuantity
    from armdyn.identify.compare import Comparison, FittedParameter
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.explained import RepairStep
    from armdyn.identify.localise import Place
    from armdyn.identify.repair import Repair
    from armdyn.identify.unseen import Judge

MOST_JOINTS = 3
"""Joints that are named in a line; of more only the number, as the JSON has them all."""


def say_comparison(found: "Comparison") -> None:
    """Print the answer of compare."""
    typer.echo(found.sentence)
    _say_fit(found)
    _say_places(found.places)
    if found.correction is not None:
        typer.echo("The right formula gives:")
        _say_parameters(found.correction.parameters)
        typer.echo("For that motion the wrong one fails at:")
        _say_places(found.correction.places)


def say_diagnosis(found: "Diagnosis") -> None:
    """Print the answer of diagnose."""
    from rich.text import Text

    console = to_screen()
    console.print(Text.assemble((found.verdict.key, "bold"), f": {found.sentence}"))
    if found.suspects:
        table = plain_table("effect", "ΔBIC", "p", "tied with")
        for s in found.suspects:
            name = f"{s.effect}:{','.join(s.joints)}" if s.joints else s.effect
            table.add_row(name, f"{s.delta_bic:.1f}", f"{s.p_value:.1e}", ", ".join(s.tied_with))
        console.print(table)
    for name, imitators in found.unseen.items():
        console.print(f"{name} cannot be seen in these runs: {', '.join(imitators)} does the same.", style="dim")
    _say_fit(found.comparison)
    _say_places(found.comparison.places)


def say_repair(found: "Repair", judges: "Sequence[Judge]") -> None:
    """Print the answer of add and repair."""
    typer.echo(found.sentence)
    _say_path(found.path, found.after.scale.units, judges)
    say_links(found.links)
    _say_fit(found.after)


def _say_fit(found: "Comparison") -> None:
    """Print parameters and channels."""
    from armdyn.preparation import of_all_runs, sentence

    console = to_screen()
    _say_parameters(found.parameters)
    examined = any(c.exam_rmse is not None for c in found.channels.values())
    heads = ("channel", "noise", "rmse", "held out", *(("exam",) if examined else ()), "χ²/sample")
    channels = plain_table(*heads)
    for name, c in found.channels.items():
        others = (c.held_out_rmse, c.exam_rmse) if examined else (c.held_out_rmse,)
        unseen = ["–" if error is None else f"{error:.4g} {c.unit}" for error in others]
        channels.add_row(
            name, f"{c.noise_std:.3g} {c.unit}", f"{c.rmse:.4g} {c.unit}", *unseen, f"{c.chi2_per_sample:.4g}"
        )
    console.print(channels)
    problem = found.fit.problem
    if done := sentence(of_all_runs(run.preparations for run in problem.runs)):
        console.print(done, style="dim")
    if not found.intervals_hold:
        console.print(found.how_certain, style="yellow")
    for text in found.left_out:
        console.print(f"{text}.", style="yellow")
    for name in found.at_bound:
        console.print(f"{name} ended on its physical bound: it may stand in for something else.", style="yellow")
    for name in found.undetermined:
        kept = next((p for n, p in found.parameters.items() if n == name), None)
        holds = "" if kept is None else f", and values that depend on it hold for {kept.value:.4g} {kept.unit}"
        console.print(f"{name} was not fitted: these runs say nothing about it{holds}.", style="dim")


def _say_parameters(parameters: "Mapping[str, FittedParameter]") -> None:
    """Print values with their standard deviations."""
    table = plain_table("parameter", "value", "std", "unit")
    for name, p in parameters.items():
        table.add_row(name, f"{p.value:.6g}", "fixed" if p.std is None else f"{p.std:.2g}", p.unit)
    if parameters:
        to_screen().print(table)


def _say_places(places: "Sequence[Place]", most: int = 6) -> None:
    """Print where the model fails."""
    console = to_screen()
    for place in places[:most]:
        run = f" in {place.run}" if place.run else ""
        console.print(
            f"  {place.channel}{run}: {place.against} {place.start:.3g} to {place.end:.3g} {place.unit}, "
            f"χ² per sample {place.chi2_per_sample:.3g}"
        )


def _say_path(path: "tuple[RepairStep, ...]", units: "Mapping[str, str]", judges: "Sequence[Judge]") -> None:
    """Print the error falling; three channels or more, such as an arm's joints, as the root of their summed squares."""
    from rich.table import Column

    from armdyn.identify.sentence import totals

    channels = list(path[0].rmse)
    together = len(channels) > 2
    unseen = ["held out", "exam"] if path[0].exam_rmse else ["held out"]
    heads = ["total rmse", *unseen] if together else [h for c in channels for h in (f"{c} rmse", *unseen)]
    columns = [Column(head, overflow="fold") for head in ("step", *heads, "χ²/sample", "BIC")]
    table = plain_table(*columns)
    for step in path:
        name = "+ " + " + ".join(step.added) if step.added else "as given"
        if step.joints:
            few = len(step.joints) <= MOST_JOINTS
            name += f" on {', '.join(step.joints)}" if few else f" on {len(step.joints)} joints"
        name += f" (or {', '.join(step.tied_with)})" if step.tied_with else ""
        kinds = (step.rmse, step.held_out_rmse, step.exam_rmse)[: 1 + len(unseen)]
        if together:
            sums = [totals(errors, units) for errors in kinds]
            cells = [", ".join(f"{e:.4g} {unit}" for unit, e in by_unit.items()) or "–" for by_unit in sums]
        else:
            errors = [errors.get(channel) for channel in channels for errors in kinds]
            cells = [f"{e:.4g}" if e is not None else "–" for e in errors]
        table.add_row(name, *cells, f"{step.chi2_per_sample:.4g}", f"{step.bic:.6g}")
    console = to_screen()
    console.print(table)
    for judge in judges:
        console.print(judge.value, style="dim")


ROWS = (
    ("mass", "kg", ("mass",)),
    ("centre of mass x, y, z", "m", ("centre_x", "centre_y", "centre_z")),
    ("mass times centre", "kg m", ("moment_x", "moment_y", "moment_z")),
    ("inertia about it xx, yy, zz", "kg m^2", ("inertia_xx", "inertia_yy", "inertia_zz")),
)
"""Rows of a link: name, unit, and which quantities; the JSON and the report have all."""


def say_links(links: "Sequence[LinkChange]") -> None:
    """Print mass, centre and inertia of every changed link beside the URDF's, then what must not be overlooked."""
    if not links:
        return
    console = to_screen()
    table = plain_table("link of", "", "URDF", "repaired", "unit")
    for link in links:
        by_name = {q.name: q for q in link.quantities}
        for i, (label, unit, names) in enumerate(ROWS):
            these = [by_name[name] for name in names]
            urdf = ", ".join(f"{q.described:.3g}" for q in these)
            table.add_row(link.joint if i == 0 else "", label, urdf, _repaired(these), unit)
    console.print(table)
    if not all(q.determined for link in links for q in link.quantities):
        console.print(UNDETERMINED_NOTE, style="dim")
    for link in links:
        if link.warning:
            console.print(f"Look out: {link.warning}.", style="yellow")


UNDETERMINED_NOTE = (
    "n.d.: not determined by these runs. Torques tell sums over several links; a value of a single link may then be "
    "wrong although the torques are right."
)


def _repaired(quantities: "Sequence[LinkQuantity]") -> str:
    if not any(q.determined for q in quantities):
        return ", ".join(f"{q.value:.3g}" for q in quantities) + " (not determined by these runs)"
    return ", ".join(f"{q.value:.3g} ± {q.std:.1g}" if q.determined else f"{q.value:.3g} (n.d.)" for q in quantities)
