"""The state at the start of a run: first guesses and candidates, from which a fit finds it."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.run import Run


class Start:
    """The start of a model without states, such as an arm's torques: each sample is predicted from that moment alone.

    A model that simulates a motion overrides this: its parameters of scope ``"per_run"`` are the state at the start of
    each run, from which a fit may go to a wrong minimum.
    """

    def guess(self, run: Run) -> Mapping[str, float]:
        """First guesses of the parameters that are one value per run."""
        del run
        return {}

    def candidates(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Possible starts of a run, from each of which a fit is tried; empty where a fit converges from anywhere.

        Args:
            run: a recording.
            theta: (p,) parameter values.
        """
        del run, theta
        return ()

    def stretch(self, theta: np.ndarray) -> float:
        """Length of a run that is long enough to choose among the candidates, s; `theta` (p,)."""
        del theta
        return np.inf

    def pieces(self, run: Run) -> Sequence[Run]:
        """The run, or the parts of it each of which has a start of its own."""
        return (run,)
