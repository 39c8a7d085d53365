"""The known weights of a calibration."""

from dataclasses import dataclass

from armdyn.errors import InputError
from armdyn.units import parse_quantity


@dataclass(frozen=True)
class Weight:
    """A known weight.

    Attributes:
        text: as the user wrote it.
        force: what it pulls with [N].
        force_std: its standard deviation [N], 0 where none was given.
    """

    text: str
    force: float
    force_std: float = 0.0


def parse_weights(text: str, gravity: float) -> tuple[Weight, ...]:
    """Read ``"0 g, 100 g, 200 g +/- 0.1 g"``; forces such as ``"1 N"`` are taken too.

    The empty cell comes first, whether it was listed or not.

    Args:
        text: separated by commas.
        gravity: free-fall acceleration [m/s^2].

    Raises:
        InputError: not a mass or a force, negative, or fewer than two different ones.
    """
    weights = [_parse(part.strip(), gravity) for part in text.split(",") if part.strip()]
    if not weights or weights[0].force > 0.0:
        weights.insert(0, Weight("0 g", 0.0))
    if len({weight.force for weight in weights}) < 2:
        raise InputError(f"--weights '{text}': give at least one weight besides the empty cell, such as '0 g, 200 g'")
    return tuple(weights)


def _parse(text: str, gravity: float) -> Weight:
    for unit, pull in (("kg", gravity), ("N", 1.0)):
        try:
            known = parse_quantity(text, unit)
        except InputError:
            continue
        if known.value < 0.0:
            raise InputError(f"--weights: '{text}' is negative: hang it so that it pulls the way the load will")
        return Weight(text, pull * known.value, pull * (known.std or 0.0))
    raise InputError(f"--weights: '{text}' is neither a mass nor a force: write '100 g', '100 g +/- 0.1 g' or '1 N'")
