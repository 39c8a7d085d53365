"""Comparisons and repairs for a person at a terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from armdyn.identify.compare import Comparison
    from armdyn.identify.diagnose import Diagnosis
    from armdyn.identify.repair import Repair


def say_comparison(console: "Console", comparison: "Comparison") -> None:
    """Channels, parameters and where it fails."""
    from rich.table import Table

    channels = Table("channel", "noise", "rms error", "held out", "χ² per sample")
    for name, c in comparison.channels.items():
        held_out = f"{c.held_out_rmse:.4g} {c.unit}" if c.held_out_rmse is not None else "-"
        row = (f"{c.noise_std:.3g} {c.unit}", f"{c.rmse:.4g} {c.unit}", held_out, f"{c.chi2_per_sample:.3g}")
        channels.add_row(name, *row)
    console.print(channels)
    parameters = Table("parameter", "value", "std")
    for name, p in comparison.parameters.items():
        parameters.add_row(name, f"{p.value:.6g} {p.unit}", f"{p.std:.2g}" if p.std is not None else "not fitted")
    console.print(parameters)
    if not comparison.intervals_hold:
        console.print("The standard deviations do not hold: the residual is more than white noise.")
    if comparison.at_bound:
        console.print(f"At a physical bound: {', '.join(comparison.at_bound)}; the data pull beyond it.")
    if comparison.undetermined:
        console.print(f"Not determined by these runs: {', '.join(comparison.undetermined)}.")
    for place in comparison.places[:6]:
        run = f" in {place.run}" if place.run else ""
        console.print(
            f"fails: {place.channel} where {place.against} is {place.start:.3g} to {place.end:.3g} {place.unit}{run}, "
            f"χ² per sample {place.chi2_per_sample:.3g}"
        )


def say_suspects(console: "Console", found: "Diagnosis") -> None:
    """Candidates, best first."""
    from rich.table import Table

    if not found.suspects:
        return
    table = Table("effect", "joints", "ΔBIC", "rms error", "held out", "cannot be told from")
    for s in found.suspects:
        rmse, held_out = (", ".join(f"{v:.3g}" for v in values.values()) for values in (s.rmse, s.held_out_rmse))
        table.add_row(s.effect, ", ".join(s.joints), f"{s.delta_bic:.1f}", rmse, held_out, ", ".join(s.tied_with))
    console.print(table)


def say_ladder(console: "Console", found: "Repair") -> None:
    """The error falling, one row per step."""
    from rich.table import Table

    table = Table("step", "rms error", "held out", "χ² per sample", "BIC", "tied with")
    for rung in found.ladder:
        step = " + ".join(rung.added) or "as given"
        step += f" ({', '.join(rung.joints)})" if rung.joints else ""
        step += f", without {', '.join(rung.removed)}" if rung.removed else ""
        rmse, held_out = (", ".join(f"{v:.4g}" for v in values.values()) for values in (rung.rmse, rung.held_out_rmse))
        table.add_row(
            step, rmse, held_out or "-", f"{rung.chi2_per_sample:.4g}", f"{rung.bic:.1f}", ", ".join(rung.tied_with)
        )
    console.print(table)
