r"""Bands: where a sample of every prediction should be, 95 times of 100.

What a prediction leaves uncertain has two parts: the values of the model, whose covariance C moves sample t by
s_t C s_t' (s_t the derivatives of its prediction), and the error e of one sample, which holds the sensor's noise and
the model's own error. Half the width of the band is

    k_c sqrt(e_c^2 + s_t C s_t'),

e_c the root mean square of channel c in the training runs. k_c would be 1.96 for an error that is Gaussian and no
larger in other motions. Neither holds on robots: so k_c is the 95 % quantile of |error| over that root in the worst of
the runs that no fit has seen, those held out and, of an arm, each training run predicted from the others (conformal
prediction with a scale of each sample's own: Lei et al., J. Am. Stat. Assoc. 113, 2018, section 5.2; whole runs are
alike by chance, not their samples: Dunn et al., J. Am. Stat. Assoc. 118, 2023). A lone training run has only itself.
The band holds for motions like those; on another kind of motion the share covered is whatever it is found to be.

What is covered is counted where k_c was not chosen: in the exam runs; where there are none, every run, or half of the
only one, is counted with the k_c that the others choose.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.problem import Block, Problem, transferred
from armdyn.identify.study import Study

LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands around the predictions of one model.

    Attributes:
        half_width: by run and channel, (n,) in the channel's unit: of training, held-out and exam runs.
        covered: by channel, the share of samples within, of runs that chose neither values nor widths.
        level: the share that should be.
    """

    half_width: dict[tuple[str, str], np.ndarray]
    covered: dict[str, float]
    level: float = LEVEL


@dataclass(frozen=True, eq=False)
class _Samples:
    """Errors (n,) of one channel in one run, and (n,) their scales: the root of `Bands` before k_c."""

    block: Block
    scale: np.ndarray

    @property
    def ratio(self) -> np.ndarray:
        return np.asarray(np.abs(self.block.misfit) / self.scale)


def bands(study: Study, fit: Fit, covariance: np.ndarray) -> Bands:
    """The bands of a fit.

    Args:
        study: runs.
        fit: to the training runs.
        covariance: (P, P) of its unknowns, 0 for those that are not fitted.
    """
    error = fit.rmse()
    training = _samples([fit], fit.problem, covariance, error)
    others = _samples(study.held_out_predictions(fit), fit.problem, covariance, error)
    exam = _samples(study.exam_predictions(fit), fit.problem, covariance, error)
    judging = others or training
    if study.held_out and study.model.linear:  # with states, fits in turn take as long as the whole study
        judging = [*others, *_samples(study.predictions_in_turn(fit), fit.problem, covariance, error)]
    shown = [*training, *(others if study.held_out else []), *exam]
    channels = list(dict.fromkeys(one.block.channel for one in training))
    factor = {channel: _factor([s.ratio for s in judging if s.block.channel == channel]) for channel in channels}
    half_width = {(s.block.run, s.block.channel): factor[s.block.channel] * s.scale for s in shown}
    covered = {}
    for channel in channels:
        apart = [s.ratio for s in exam if s.block.channel == channel]
        within = [ratio <= factor[channel] for ratio in apart] if apart else _crossed(judging, channel)
        covered[channel] = float(np.mean(np.concatenate(within)))
    return Bands(half_width, covered)


def _samples(fits: Sequence[Fit], problem: Problem, covariance: np.ndarray, error: dict[str, float]) -> list[_Samples]:
    """Every channel of some runs, the values of whose predictions are uncertain as those of a problem are."""
    uncertain = np.flatnonzero(np.diag(covariance) > 0.0)
    found = []
    for one in fits:
        place = transferred(np.arange(len(problem.columns), dtype=float), problem, one.problem, missing=-1.0).astype(
            int
        )
        own = np.flatnonzero(np.isin(place, uncertain))
        C = covariance[np.ix_(place[own], place[own])]
        wanted = np.isin(np.arange(len(place)), own)
        moving = one.blocks if one.problem is problem else one.problem.blocks(one.values, wanted)
        for block, derivatives in zip(one.blocks, moving, strict=True):
            S = derivatives.sensitivities[:, own] * block.noise
            variance = np.einsum("np,pq,nq->n", S, C, S, optimize=True)
            # Values that nothing determines say nothing of what they move.
            variance = np.where(np.isfinite(variance), np.maximum(variance, 0.0), 0.0)
            found.append(_Samples(block, np.sqrt(error[block.channel] ** 2 + variance)))
    return found


def _factor(runs: Sequence[np.ndarray]) -> float:
    """k_c: the largest quantile of any run; 1.96 where there is no error at all."""
    known = [run[np.isfinite(run)] for run in runs]
    return max((float(np.quantile(run, LEVEL)) for run in known if len(run)), default=1.96)


def _crossed(judging: Sequence[_Samples], channel: str) -> list[np.ndarray]:
    """Which samples are within a band whose width other runs, or the other half of the only run, have chosen."""
    parts = [s.ratio for s in judging if s.block.channel == channel]
    if len(parts) == 1:
        parts = np.array_split(parts[0], 2)
    return [part <= _factor([other for other in parts if other is not part]) for part in parts]
