"""Recordings of one robot that are compared with its model together, for every hypothesis on mistakes in them.

What a model lacks belongs to the robot, so that its size is the same in all recordings of an arm; a mistake belongs to
a description, to a logger or to one recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.estimation.solve import pseudo_inverse
from armdyn.inspection.arm import RecordingHypothesis, SampledArmRun
from armdyn.inspection.correction import Correction
from armdyn.inspection.description import AS_DESCRIBED, NOTHING_DESCRIBED, DescriptionCorrection
from armdyn.inspection.evidence import Evidence, ReadingSums, evidence
from armdyn.run import Run

AS_IS: RecordingHypothesis = (Correction(), AS_DESCRIBED)
"""The hypothesis that neither a recording nor the description has a mistake."""


class SampledRun(Protocol):
    """A recording at a few moments, which is compared with a model."""

    @property
    def run(self) -> Run:
        """The recording."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""
        ...

    def sums(self, correction: Correction, description: DescriptionCorrection) -> ReadingSums:
        """What the evidence of a hypothesis needs of this recording."""
        ...

    def coarse_log_evidence(self, meanings: Sequence[RecordingHypothesis]) -> np.ndarray:
        """(h,) approximate log evidence of hypotheses, nats."""
        ...

    def corrected(self, correction: Correction) -> Self:
        """The recording with a correction."""
        ...


Sampled = TypeVar("Sampled", bound=SampledRun)


@dataclass(frozen=True, eq=False)
class SampledRuns(Generic[Sampled]):
    """Recordings of one robot at a few moments each, whose missing effects have the same sizes.

    Attributes:
        runs: the recordings.
    """

    runs: tuple[Sampled, ...]

    def only(self, which: Sequence[int]) -> Self:
        """Some of the recordings, by their indices."""
        return replace(self, runs=tuple(self.runs[k] for k in which))

    def corrected(self, correction: Correction, which: Sequence[int]) -> Self:
        """The recordings, of which some are corrected."""
        runs = (run.corrected(correction) if k in which else run for k, run in enumerate(self.runs))
        return replace(self, runs=tuple(runs))

    def evidence(
        self, meaning: RecordingHypothesis, which: Sequence[int], absent: np.ndarray | None = None
    ) -> Evidence:
        """Evidence of a hypothesis on some recordings, where the others are as they stand.

        Args:
            meaning: the hypothesis.
            which: indices of the recordings that it concerns.
            absent: (p,) bool, effects that are not considered; None for none of them.
        """
        parts = [run.sums(*(meaning if k in which else AS_IS)) for k, run in enumerate(self.runs)]
        return evidence(ReadingSums.joined(parts), absent)

    def evidence_of_no_model(self, which: Sequence[int]) -> float:
        """Log evidence, nats, of a model that explains nothing in some recordings; a mistake must have more."""
        return max(self.evidence((Correction(), nothing), which).value for nothing in NOTHING_DESCRIBED)

    @cached_property
    def units(self) -> tuple[tuple[int, str], ...]:
        """(U,) index of the recording, and channel, of each unit of the evidence."""
        return tuple((k, channel) for k, run in enumerate(self.runs) for channel in run.channels)

    @property
    def positions_with_zeros(self) -> tuple[str, ...]:
        """Positions whose zeros may be off by any angle; none where only quarter turns are looked for."""
        return ()

    def columns_of_effect(self, effect: str) -> np.ndarray:
        """(p,) bool, the unknowns of the evidence that belong to an effect; none where effects have no names."""
        del effect
        return np.zeros(len(self.runs[0].sums(*AS_IS).sizes.kind), dtype=bool)


class SampledArmRuns(SampledRuns[SampledArmRun]):
    """Recordings of one arm at a few moments each."""

    @property
    def model(self) -> ArmModel:
        """The arm's model with its effects."""
        return self.runs[0].model

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the arm's joints."""
        return self.model.joints

    @property
    def positions_with_zeros(self) -> tuple[str, ...]:
        """Positions of the joints that turn."""
        return tuple(f"q.{joint}" for joint in self.joints if not self.model.arm.sliding[joint])

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the torque channels of the recordings."""
        return tuple(dict.fromkeys(channel for run in self.runs for channel in run.channels))

    def has(self, channel: str) -> bool:
        """Whether a recording has a channel."""
        return any(channel in run.run.channels for run in self.runs)

    @cached_property
    def measured(self) -> tuple[np.ndarray, ...]:
        """For each torque channel, (n,) recorded torques at the moments of all recordings, N m or N."""
        return self._of_channels([run.measured for run in self.runs])

    @cached_property
    def described(self) -> tuple[np.ndarray, ...]:
        """For each torque channel, (n,) torques of the model at the moments of all recordings, N m or N."""
        return self._of_channels([run.described_torques(run.motion) for run in self.runs])

    def _of_channels(self, values: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        return tuple(
            np.concatenate([v[r.channels.index(c)] for r, v in zip(self.runs, values, strict=True) if c in r.channels])
            for c in self.channels
        )

    @cached_property
    def gravity(self) -> np.ndarray:
        """(3,) gravity in the base's frame, m/s^2, that fits the torques best, with friction and offsets."""
        return _solution([run.gravity_equations for run in self.runs])

    @cached_property
    def inertial_factor(self) -> float:
        """Factor on all inertial torques that fits the torques best, with friction and offsets."""
        return float(_solution([run.inertial_equations for run in self.runs])[0])

    def columns_of_effect(self, effect: str) -> np.ndarray:
        """(p,) bool, the unknowns of the evidence that belong to an effect."""
        return self.runs[0].effects.columns_of_effect(effect)


def _solution(equations: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(g,) solution of the sum of normal equations (g, g) and (g,)."""
    matrices, vectors = zip(*equations, strict=True)
    return np.asarray(pseudo_inverse(np.sum(matrices, axis=0), 1e-6) @ np.sum(vectors, axis=0))
