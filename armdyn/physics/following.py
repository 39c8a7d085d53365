"""How a simulation follows a recorded motion: from one start or from many, and in how short steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.recording.noise import NoiseByChannel
from armdyn.run import Run

MAX_REFINEMENT = 8
"""Largest number of steps in place of one, where a contact or an edge falls into a step."""


@dataclass(frozen=True)
class Following:
    """How a simulation follows a recorded motion.

    Attributes:
        restart: time, s, after which predictions start anew from the measured motion, because an error of the start
            would grow to the size of the motion; None where a whole run is predicted from its first state.
        refinement: number of steps in place of each step that is stable, because a contact inside one makes it wrong.
    """

    restart: float | None = None
    refinement: int = 1

    @property
    def remark(self) -> str:
        """A sentence, without a full stop, on predictions that start anew; empty where they do not."""
        if self.restart is None:
            return ""
        return (
            f"Unstable over these durations: predictions start anew every {self.restart:.2g} s from the measured motion"
        )


Predictions = Callable[[Following, Run, np.ndarray], Mapping[str, np.ndarray]]
"""Predicted values by channel of a run at (p,) parameters."""


def with_exact_steps(
    following: Following,
    predicted: Predictions,
    runs: Sequence[Run],
    thetas: Sequence[np.ndarray],
    noise: NoiseByChannel,
) -> Following:
    """Halve the steps until chi2 of the runs stays.

    A contact or an edge inside a step makes it less exact than the method's order promises. Chi2 stays if it changes by
    no more than it varies by chance, and, far above the noise, by no larger share.

    Args:
        following: how the runs are followed.
        predicted: predictions of the runs.
        runs: the runs.
        thetas: (p,) parameters of each run.
        noise: standard deviation of a sample by run and channel, in the channel's unit.
    """

    @np.errstate(all="ignore")  # a simulation that diverges has no chi2 that could change
    def chi2(one: Following) -> tuple[float, int]:
        total, count = 0.0, 0
        for run, theta in zip(runs, thetas, strict=True):
            for name, value in predicted(one, run, theta).items():
                total += float(np.sum((run.channels[name].value - value) ** 2)) / noise[run.name, name] ** 2
                count += len(value)
        return total, count

    coarse, count = chi2(following)
    while following.refinement < MAX_REFINEMENT:
        finer = replace(following, refinement=2 * following.refinement)
        fine, _ = chi2(finer)
        if not abs(coarse - fine) > np.sqrt(2.0 * count) * max(coarse / count, 1.0):
            break
        following, coarse = finer, fine
    return following
