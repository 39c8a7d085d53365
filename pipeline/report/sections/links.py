"""Links in kg, m and kg m^2, as the URDF has them and as repaired."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pipeline.report.section import Section, Table

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange

NAMES = {"mass": "mass", "centre": "centre of mass", "inertia": "inertia", "moment": "mass times centre"}


@dataclass(frozen=True)
class LinkSection(Section):
    """What the repair did to the links, and which of it the runs determine."""

    title: ClassVar[str] = "Links"

    links: Sequence["LinkChange"]

    def sentence(self) -> str:
        """How much is determined, and what must not be overlooked."""
        every = [q for link in self.links for q in link.quantities]
        determined = sum(q.determined for q in every)
        text = f"These runs determine {determined} of {len(every)} values. "
        if determined < len(every):
            text += (
                "Torques tell sums over several links; a value of a single link that is not determined may be wrong "
                "although the torques are right. "
            )
        return text + " ".join(f"Look out: {link.warning}." for link in self.links if link.warning)

    def tables(self) -> Sequence[Table]:
        """A table per link."""
        return [self._table(link) for link in self.links]

    @staticmethod
    def _table(link: "LinkChange") -> Table:
        rows = []
        for q in link.quantities:
            kind, _, axis = q.name.partition("_")
            name = f"{NAMES[kind]} {axis}".strip()
            # What rounding left of an exact zero says nothing.
            value = q.value if abs(q.value) > 1e-6 * max(q.std, abs(q.described)) else 0.0
            certain = "yes" if q.determined else "not by these runs"
            rows.append([name, f"{q.described:.4g}", f"{value:.4g}", f"{q.std:.2g}", q.unit, certain])
        caption = (
            f"The link that {link.joint} moves, with all that is fixed to it, in the frame of that joint; inertia "
        )
        return Table(
            [link.joint, "URDF", "repaired", "std", "unit", "determined"],
            rows,
            caption + "is about the centre of mass.",
        )
