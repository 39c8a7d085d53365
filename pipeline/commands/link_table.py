"""The links that a repair changed, on the screen."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.commands.output import to_screen

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange, LinkQuantity

ROWS = (
    ("mass", "kg", ("mass",)),
    ("centre of mass x, y, z", "m", ("centre_x", "centre_y", "centre_z")),
    ("mass times centre", "kg m", ("moment_x", "moment_y", "moment_z")),
    ("inertia about it xx, yy, zz", "kg m^2", ("inertia_xx", "inertia_yy", "inertia_zz")),
)
"""Rows of a link: name, unit, and which quantities; the JSON and the report have all."""


def say_links(links: "Sequence[LinkChange]") -> None:
    """Print mass, centre and inertia of every changed link beside the URDF's, then what must not be overlooked."""
    from rich.markup import escape
    from rich.table import Table

    if not links:
        return
    console = to_screen()
    table = Table("link of", "", "URDF", "repaired", "unit", box=None, header_style="dim")
    for link in links:
        by_name = {q.name: q for q in link.quantities}
        for i, (label, unit, names) in enumerate(ROWS):
            these = [by_name[name] for name in names]
            urdf = ", ".join(f"{q.described:.3g}" for q in these)
            table.add_row(escape(link.joint) if i == 0 else "", label, urdf, _repaired(these), unit)
    console.print(table)
    if not all(q.determined for link in links for q in link.quantities):
        console.print(f"[dim]{UNDETERMINED_NOTE}[/]")
    for link in links:
        if link.warning:
            console.print(f"[yellow]Look out: {escape(link.warning)}.[/]")


UNDETERMINED_NOTE = (
    "n.d.: not determined by these runs. Torques tell sums over several links; a value of a single link may then be "
    "wrong although the torques are right."
)


def _repaired(quantities: "Sequence[LinkQuantity]") -> str:
    if not any(q.determined for q in quantities):
        return ", ".join(f"{q.value:.3g}" for q in quantities) + " (not determined by these runs)"
    return ", ".join(f"{q.value:.3g} ± {q.std:.1g}" if q.determined else f"{q.value:.3g} (n.d.)" for q in quantities)
