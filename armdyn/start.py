"""How the motion of a run began: what a model says of it, so that a fit can find it."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.run import Run


class Start:
    """The start of a model without states, such as an arm's torques: every sample is predicted by itself.

    A model that simulates a motion overrides this: its parameters of scope ``"per_run"`` are the state at the start of
    each run, from which a fit may go to a wrong minimum.

    Attributes:
        window: shortest stretch of a run, s, that a fit from afar starts with; None where any start will do.
    """

    window: float | None = None

    def guess(self, run: Run) -> Mapping[str, float]:
        """First guesses of the parameters that are one value per run."""
        del run
        return {}

    def candidates(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Starts that a run may have had, from which a fit is tried; empty where a fit finds the start from anywhere.

        Args:
            run: a recording.
            theta: (p,) parameter values.
        """
        del run, theta
        return ()

    def stretch(self, theta: np.ndarray) -> float:
        """How much of a run tells the candidates apart, s; `theta` (p,)."""
        del theta
        return np.inf

    def pieces(self, run: Run) -> Sequence[Run]:
        """The run, or the parts of it each of which has a start of its own."""
        return (run,)
