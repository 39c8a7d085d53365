r"""Prediction bands: intervals around the predicted samples that should contain 95 % of the measured ones.

The uncertainty of a prediction has two parts: the model's values, whose covariance C gives sample t the variance
s_t C s_t' (s_t the derivatives of its prediction), and the error e of one sample, which contains the sensor's noise and
the model's own error. Half the width of the band is

    k_c sqrt(e_c^2 + s_t C s_t'),

e_c the root mean square of channel c in the training runs. k_c would be 1.96 for an error that is Gaussian and no
larger in other motions. Neither holds on robots, so k_c is a quantile: 95 % of |error| over that root are below it in
the worst of the runs that were not fitted. These are the held-out runs and, for an arm, each training run predicted by
a fit to the others (conformal prediction with a scale for each sample: Lei et al., J. Am. Stat. Assoc. 113, 2018,
section 5.2; runs are exchangeable, the samples of one run are not: Dunn et al., J. Am. Stat. Assoc. 118, 2023). A
single training run is judged by its own residual. The band holds for motions of the same kind; on another kind of
motion the measured coverage is reported. An exam run that leaves the band where it leaves the range has none: what the
model lacks grows there by an amount that no fitted run shows.

The coverage is counted in runs that did not choose k_c: in the exam runs; where there are none, each run (or each half
of a single run) is counted with the k_c that the others choose.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.problem import Problem, transfer_values
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.study import Study

COVERAGE_LEVEL = 0.95
"""Share of the samples that a prediction band should contain."""
LEAST_COVERAGE = 0.9
"""Share of a run's samples inside its band from which on the band holds in this run."""
LEFT_RANGE_SHARE, LEFT_RANGE_SAMPLES = 0.25, 0.01
"""Distance from the range of a quantity in the fitted runs, as a share of that range, beyond which a run extrapolates
if at least this share of its samples lies there."""


@dataclass(frozen=True)
class Extrapolation:
    """An exam run in which the band does not hold, because a quantity leaves its range in the fitted runs.

    Attributes:
        run: name of the run.
        quantity: name of the quantity.
        value: its value furthest from the range, in `unit`.
        low: least value in the fitted runs, in `unit`.
        high: largest value in the fitted runs, in `unit`.
        unit: unit of the quantity.
    """

    run: str
    quantity: str
    value: float
    low: float
    high: float
    unit: str

    @property
    def sentence(self) -> str:
        """What left which range, without a full stop."""
        return (
            f"{self.run}: {self.quantity} comes to {self.value:.3g} {self.unit}, in the fitted runs from "
            f"{self.low:.3g} to {self.high:.3g} {self.unit}: the model was not fitted there, and its band does not hold"
        )


@dataclass(frozen=True, eq=False)
class PredictionBands:
    """Prediction bands of one fitted model.

    Attributes:
        half_width: half the width of the band, (n,) in the channel's unit, by run and channel, for training, held-out
            and exam runs; exam runs in which no band holds have none.
        coverage: measured share of the samples inside the band, by channel, in runs that were used neither to fit the
            values nor to choose the widths.
        extrapolations: exam runs in which no band holds, with the reason.
    """

    half_width: dict[tuple[str, str], np.ndarray]
    coverage: dict[str, float]
    extrapolations: tuple[Extrapolation, ...] = ()


@dataclass(frozen=True, eq=False)
class _Samples:
    """Errors (n,) of one channel in one run, and their scales (n,): the square root in the module's formula."""

    block: ResidualBlock
    scale: np.ndarray

    @property
    def ratio(self) -> np.ndarray:
        return np.asarray(np.abs(self.block.misfit) / self.scale)


def prediction_bands(study: Study, fit: Fit, covariance: np.ndarray) -> PredictionBands:
    """Compute the prediction bands of a fit; the docstring of the module describes the method.

    Args:
        study: the runs.
        fit: the fit to the training runs.
        covariance: (P, P) covariance of the fit's unknowns, 0 for unknowns that are not fitted.
    """
    error = fit.rmse()
    training = _samples([fit], fit.problem, covariance, error)
    others = _samples(study.held_out_predictions(fit), fit.problem, covariance, error)
    exam = _samples(study.exam_predictions(fit), fit.problem, covariance, error)
    beside = _samples(study.cross_predictions_of_training(fit), fit.problem, covariance, error)
    shown = [*training, *(others if study.held_out else []), *exam]
    channels = list(dict.fromkeys(one.block.channel for one in training))
    # A channel that no other run has, as where a drive was at its limit, is judged by its training runs.
    judging = {
        channel: [s for s in (*others, *beside) if s.block.channel == channel]
        or [s for s in training if s.block.channel == channel]
        for channel in channels
    }
    factor = {channel: _factor([s.ratio for s in judging[channel]]) for channel in channels}
    half_width = {(s.block.run, s.block.channel): factor[s.block.channel] * s.scale for s in shown}
    covered = {}
    for channel in channels:
        apart = [s.ratio for s in exam if s.block.channel == channel]
        crossed = [] if apart else _crossed([s.ratio for s in judging[channel]])
        within = [ratio <= factor[channel] for ratio in apart] or crossed
        covered[channel] = float(np.mean(np.concatenate(within)))
    left = tuple(_extrapolations(study, fit, half_width))
    holding = {key: half for key, half in half_width.items() if all(key[0] != one.run for one in left)}
    return PredictionBands(holding, covered, left)


def _samples(fits: Sequence[Fit], problem: Problem, covariance: np.ndarray, error: dict[str, float]) -> list[_Samples]:
    """Errors and scales of every channel, by run; the predictions are as uncertain as the values of `problem`."""
    uncertain = np.flatnonzero(np.diag(covariance) > 0.0)
    found = []
    for one in fits:
        place = transfer_values(
            np.arange(len(problem.columns), dtype=float), problem, one.problem, missing=-1.0
        ).astype(int)
        own = np.flatnonzero(np.isin(place, uncertain))
        C = covariance[np.ix_(place[own], place[own])]
        wanted = np.isin(np.arange(len(place)), own)
        moving = one.blocks if one.problem is problem else one.problem.blocks(one.values, wanted)
        for block, derivatives in zip(one.blocks, moving, strict=True):
            S = derivatives.sensitivities[:, own] * block.noise
            variance = np.einsum("np,pq,nq->n", S, C, S, optimize=True)
            # Unknowns that the data do not determine must not widen the band of what they move.
            variance = np.where(np.isfinite(variance), np.maximum(variance, 0.0), 0.0)
            found.append(_Samples(block, np.sqrt(error[block.channel] ** 2 + variance)))
    return found


def _factor(runs: Sequence[np.ndarray]) -> float:
    """k_c: the largest quantile of any run; 1.96 where there is no error at all."""
    known = [run[np.isfinite(run)] for run in runs]
    return max((float(np.quantile(run, COVERAGE_LEVEL)) for run in known if len(run)), default=1.96)


def _crossed(parts: list[np.ndarray]) -> list[np.ndarray]:
    """For each sample, whether it is inside a band whose width other runs (or the other half of one run) chose."""
    if len(parts) == 1:
        parts = np.array_split(parts[0], 2)
    return [part <= _factor([other for other in parts if other is not part]) for part in parts]


def _extrapolations(
    study: Study, fit: Fit, half_width: Mapping[tuple[str, str], np.ndarray]
) -> Iterator[Extrapolation]:
    """Exam runs that leave both the range of the fitted runs and their own band, `half_width` by run and channel.

    What a model lacks may grow there, and no residual of a fitted run shows how much.
    """
    fitted: dict[str, list[np.ndarray]] = {}
    for signals in fit.covariates().values():
        for name, channel in signals.items():
            fitted.setdefault(name, []).append(channel.value)
    ranges = {name: (float(np.min(np.concatenate(v))), float(np.max(np.concatenate(v)))) for name, v in fitted.items()}
    for one in study.exam_predictions(fit):
        within = [np.abs(b.misfit) <= half_width.get((b.run, b.channel), np.inf) for b in one.blocks]
        if np.mean(np.concatenate(within)) >= LEAST_COVERAGE:
            continue
        for run, signals in one.covariates().items():
            beyond = {name: _beyond(signals[name].value, *ranges[name]) for name in signals if name in ranges}
            name = max(beyond, key=lambda key: beyond[key][0], default="")
            if name and beyond[name][0] > LEFT_RANGE_SHARE:
                yield Extrapolation(run, name, beyond[name][1], *ranges[name], signals[name].unit)


def _beyond(values: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Distance of the (n,) values' ends from a range, as a share of it, and the end that is further away."""
    if not high > low:
        return 0.0, low
    least, most = np.quantile(values, [LEFT_RANGE_SAMPLES, 1.0 - LEFT_RANGE_SAMPLES])
    below, above = (low - least) / (high - low), (most - high) / (high - low)
    return (float(below), float(least)) if below > above else (float(above), float(most))
