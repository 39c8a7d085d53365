"""Pairs that no motion of the gripper tells apart, and why, as far as the equations say it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.experiments.hypothesis import Experiment, Held, Hypothesis
from armdyn.experiments.separation import Outlook, Rival

INSEPARABLE = 1.0
"""Rise of chi2, after design for it, below which a pair counts as inseparable by motion: far below any margin."""
ALIKE = 0.05
"""Of a constant difference of the swing angles, what they may vary beside it and still count as turned."""
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


def inseparable(
    hypotheses: Sequence[Hypothesis], outlook: Outlook, experiment: Experiment
) -> tuple[Inseparable, ...]:
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
    angle = truth.swing(truth.start) - rival.swing(best)
    turned = float(np.mean(angle))
    whole = float(np.sqrt(rise / max(len(angle), 1)))
    changes = _changes(first, rival, best)
    said = f"along every motion {second.name} with {changes} predicts what {first.name} does ({whole:.1g} of the noise apart)"
    if np.std(angle) < ALIKE * abs(turned) and abs(turned) > TURNED:
        said += (
            f": the load swings alike, about a vertical that is turned by {abs(turned):.3g} rad, and a rotation of the "
            "frame is no force that a load cell could see"
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
