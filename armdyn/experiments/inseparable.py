"""Pairs that no motion of the gripper tells apart, and why, as far as the equations say it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.experiments.hypothesis import Experiment, Held, Hypothesis
from armdyn.experiments.separation import Outlook, Rival

INSEPARABLE = 1.0
"""Rise of chi2, after design for it, below which a pair counts as inseparable by motion: far below any margin."""
ALIKE = 0.02
"""Share by which two angles may differ and still count as the same."""
TURNED = 1e-3
"""rad; a smaller turn is not worth telling."""
NOTICED = 0.02
"""Change of an unknown, in typical sizes, that a reader is told."""


@dataclass(frozen=True)
class Inseparable:
    """A pair that a designed motion does not tell apart.

    Attributes:
        effects: names of the two.
        why: a sentence.
    """

    effects: tuple[str, str]
    why: str


def inseparable(hypotheses: Sequence[Hypothesis], outlook: Outlook, experiment: Experiment) -> tuple[Inseparable, ...]:
    """All pairs of which neither can be told from the other along the motion that was designed for that."""
    found = []
    for i, first in enumerate(hypotheses):
        for j in range(i + 1, len(hypotheses)):
            second = hypotheses[j]
            if max(outlook.rises[i, j], outlook.rises[j, i]) < INSEPARABLE:
                found.append(Inseparable((first.name, second.name), _why(first, second, experiment)))
    return tuple(found)


def _why(first: Hypothesis, second: Hypothesis, experiment: Experiment) -> str:
    """What the second has to change so that it predicts what the first does."""
    truth, rival = Held(first, experiment), Held(second, experiment)
    rise, best = Rival(rival, truth.predict(truth.start)[0]).refitted()
    whole = float(np.sqrt(rise / max(len(truth.predict(truth.start)[0]), 1)))
    said = (
        f"along every motion {second.name} with {_changes(first, rival, best)} predicts what {first.name} does "
        f"({whole:.1g} of the noise apart)"
    )
    values = {name: float(value) for name, value in zip(rival.names, best, strict=True)}
    own = second.model.start_names
    hangs = second.model.with_values({n: v for n, v in values.items() if n not in own}).rest_angle()
    if abs(hangs) > TURNED and abs(hangs - first.rest_angle) < ALIKE * abs(hangs):
        said += (
            f": both turn the direction in which the load hangs by {abs(hangs):.3g} rad, and apart from that nothing: "
            "a rotation of the frame"
        )
    return said


def _changes(first: Hypothesis, rival: Held, best: np.ndarray) -> str:
    own = {n: p for n, p in rival.hypothesis.model.parameters.items() if p.effect and n not in first.model.names}
    parts = []
    for i, name in enumerate(rival.names):
        p = rival.hypothesis.model.parameters[name]
        if name in own:
            parts.append(f"{name} = {best[i]:.3g} {p.unit}")
        elif name in first.model.names:
            given = first.model.value(name) if name not in rival.hypothesis.model.start_names else None
            base = first.rest_angle if name == "initial_angle" else 0.0 if given is None else given
            if abs(best[i] - base) > NOTICED * p.typical:
                parts.append(f"{name} off by {best[i] - base:.3g} {p.unit}")
    return " and ".join(parts) or "the same values"
