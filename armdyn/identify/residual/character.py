"""Describe the residual of an effect that is not in the catalogue: its kind, on what it depends, its frequency."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import chdtrc

from armdyn.estimation.descent import descend_each
from armdyn.estimation.equations import NormalEquations
from armdyn.identify.fit import Fit
from armdyn.identify.noise import WhiteningFilter, whitening_filters
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import blocks_by_channel
from armdyn.physics.pieces import MotionPieces
from armdyn.physics.restarts import piece_equations
from armdyn.physics.simulated import as_model_with_motion
from armdyn.recording.channel_names import channel_full_name
from armdyn.recording.channels import is_auxiliary
from armdyn.run import Run

MAX_RESIDUAL_TERMS = 3
"""Largest number of terms that describe a residual."""
RESIDUAL_SEGMENT_SECONDS = 1.5
"""Length of a segment, s, in which a fitted start state absorbs missing dynamics but no sensor error."""
START_STATE_STEPS = 3
"""Number of Gauss-Newton steps for the start state of a segment, in which predictions are nearly linear."""
MIN_ERROR_TO_NOISE_VARIANCE = 1.05
"""Squared error per sample, over the noise variance, below which the kind of the missing effect is not estimated."""
MIN_DYNAMICS_PROCESS_ERROR_SHARE, MAX_SENSOR_PROCESS_ERROR_SHARE = 0.7, 0.4
"""Process-error share above which missing dynamics, and share below which a sensor error, is named as the cause."""
QUARTER_OF_FREQUENCY_COUNT = 600
"""A quarter of the number of frequencies at which the power of a residual is computed."""
SINE_VALUES_AT_ONCE = 2**19
"""Number of values of sines that are computed at once, which limits the memory."""


@dataclass(frozen=True)
class ResidualTerm:
    """One function of measured signals that explains part of a residual.

    Attributes:
        channel: the channel of the residual.
        expression: the function, such as ``"sign(swing_rate)"``.
        share: share of the squared residual that it explains.
        p_value: probability of so large a share by chance, times the number of functions tried.
    """

    channel: str
    expression: str
    share: float
    p_value: float

    @property
    def in_words(self) -> str:
        """The function for a reader, such as ``"the sign of the velocity of elbow"``."""
        for form, words in WORDS_OF_FUNCTIONS.items():
            found = re.fullmatch(form, self.expression)
            if found is not None:
                return words.format(*(channel_full_name(name) for name in found.groups()))
        return self.expression


WORDS_OF_FUNCTIONS = {
    r"([\w.-]+)": "the {}",
    r"([\w.-]+)\^2": "the square of the {}",
    r"([\w.-]+)\^3": "the cube of the {}",
    r"\|([\w.-]+)\| \1": "the square of the {}, with its sign",
    r"sign\(([\w.-]+)\)": "the sign of the {}",
    r"\[([\w.-]+) > 0\]": "whether the {} is positive",
    r"\[([\w.-]+) > 0\] sign\(([\w.-]+)\)": "the sign of the {1} where the {0} is positive",
    r"([\w.-]+) ([\w.-]+)": "the product of {} and {}",
}
"""Words for the functions of signals that `_library` builds, by their form."""


@dataclass(frozen=True)
class SpectralPeak:
    """The strongest frequency of a channel's residual.

    Attributes:
        channel: the channel.
        frequency: frequency, Hz.
        amplitude: amplitude of the oscillation, in `unit`.
        unit: unit of the channel.
        p_value: probability of so strong a frequency by chance.
    """

    channel: str
    frequency: float
    amplitude: float
    unit: str
    p_value: float


@dataclass(frozen=True)
class ResidualCharacter:
    """Description of a residual that no effect of the catalogue explains.

    Attributes:
        process_error: share of the squared residual, 0 to 1, that vanishes if every short segment starts from a fitted
            state; large for missing dynamics, small for a sensor error. None where the model has no start state.
        terms: functions of measured signals on which the residual depends, the best first.
        peaks: strongest frequencies, for the channels that have one.
    """

    process_error: float | None
    terms: tuple[ResidualTerm, ...]
    peaks: tuple[SpectralPeak, ...]

    @property
    def significant(self) -> bool:
        """Whether the residual has structure that coloured noise would not have."""
        return bool(self.terms or self.peaks)

    @property
    def headline(self) -> str:
        """The probable cause, and the signal on which the residual depends most, in few words."""
        cause = [] if self.process_error is None else [probable_cause_text(self.process_error)]
        return "; ".join([*cause, *(f"it depends on {term.in_words}" for term in self.terms[:1])])

    @property
    def sentence(self) -> str:
        """The description of the residual in one sentence, for a reader."""
        parts = []
        if self.process_error is not None:
            share = f"({100 * self.process_error:.0f} % of it vanishes if short pieces start from states of their own)"
            parts.append(f"{probable_cause_text(self.process_error)} {share}")
        if self.terms:
            parts.append("it depends on " + ", ".join(term.in_words for term in self.terms))
        if self.peaks:
            parts.append("it is strongest at " + ", ".join(f"{peak.frequency:.2f} Hz" for peak in self.peaks))
        return "; ".join(parts)


def residual_sentence(character: ResidualCharacter | None) -> str:
    """Sentence on what is left after a fit, followed by a blank; empty where that is noise."""
    said = character.sentence if character is not None else ""
    return f"The remaining error {said.removeprefix('it ')}. " if said else ""


def probable_cause_text(process_error: float) -> str:
    """Words for the probable cause of a residual, missing dynamics or a sensor error, from its process-error share."""
    if process_error > MIN_DYNAMICS_PROCESS_ERROR_SHARE:
        return "it behaves like missing dynamics"
    return (
        "it behaves like a sensor error"
        if process_error < MAX_SENSOR_PROCESS_ERROR_SHARE
        else "it may be missing dynamics or a sensor error"
    )


def characterise(fit: Fit) -> ResidualCharacter:
    """Describe the residual of a fit: its probable cause, the signals on which it depends, its frequencies."""
    filters = whitening_filters(fit.blocks)
    return ResidualCharacter(
        process_error_share(fit), matching_pursuit_terms(fit, filters), spectral_peaks(fit, filters)
    )


def process_error_share(fit: Fit) -> float | None:
    """Share of the squared residual of a fit that vanishes if every segment of 1.5 s starts from a fitted state.

    None for a model without states or one that is predicted in pieces, and where the residual is of the noise's size.
    """
    problem = fit.problem
    model = as_model_with_motion(problem.model)
    if model is None or model.following.restart is not None or fit.chi2_per_sample < MIN_ERROR_TO_NOISE_VARIANCE:
        return None
    left = samples = 0.0
    for i, run in enumerate(problem.runs):
        theta, pieces = problem.theta(i, fit.values), MotionPieces(model, run, RESIDUAL_SEGMENT_SECONDS)
        begun = pieces.rolled_out_states(theta)
        linearise = partial(_equations_of_states, problem, run, pieces, theta)
        best, n = descend_each(linearise, begun, START_STATE_STEPS).equations, begun.shape[1]
        told = best.count > n
        left += float(best.square[told].sum())
        samples += float((best.count[told] - n).sum())
    excess = fit.chi2 - fit.samples
    if excess <= 0.0:
        return None
    return float(np.clip((fit.chi2 - left * fit.samples / max(samples, 1.0)) / excess, 0.0, 1.0))


def _equations_of_states(
    problem: Problem, run: Run, pieces: MotionPieces, theta: np.ndarray, states: np.ndarray
) -> NormalEquations:
    """Equations of (J, n) states in which the pieces of a run begin."""
    noise = {channel: problem.noise[run.name, channel] for channel in pieces.channels}
    return piece_equations(pieces.linearise(theta, states, np.zeros(0, dtype=int)), noise, len(states))


def matching_pursuit_terms(fit: Fit, filters: Mapping[str, WhiteningFilter]) -> tuple[ResidualTerm, ...]:
    """Find functions of measured signals on which the residual of a fit depends, by orthogonal matching pursuit.

    Args:
        fit: the fit.
        filters: whitening filter of the residual, by channel.
    """
    covariates, channels, found = fit.covariates(), blocks_by_channel(fit.blocks), list[ResidualTerm]()
    for channel, blocks in channels.items():
        white = filters[channel]
        names = set.intersection(*(set(covariates[b.run]) for b in blocks))
        joint = "" if is_auxiliary(channel) else channel.partition(".")[2]
        if joint:
            names = {n for n in names if n.endswith(f".{joint}")}
        library = _library({n: [b.interpolate(covariates[b.run][n]) for b in blocks] for n in sorted(names)})
        if not library:
            continue
        y = np.concatenate([white(b.residual) for b in blocks])
        fitted = np.concatenate([white(b.sensitivities[:, fit.free]) for b in blocks])
        columns = {e: np.concatenate([white(v) for v in values]) for e, values in library.items()}
        total = float(y @ y)
        basis = np.linalg.qr(fitted)[0]
        for _ in range(MAX_RESIDUAL_TERMS):
            y = y - basis @ (basis.T @ y)
            best, gain, direction = "", 0.0, np.zeros(len(y))
            for expression, column in columns.items():
                rest = column - basis @ (basis.T @ column)
                size = float(np.linalg.norm(rest))
                if size > 1e-3 * np.linalg.norm(column) and (drop := float(rest @ y) ** 2 / size**2) > gain:
                    best, gain, direction = expression, drop, rest / size
            p = min(1.0, len(channels) * len(columns) * float(chdtrc(1, gain)))
            if not best or p > fit.problem.settings.verdict.term_probability:
                break
            found.append(ResidualTerm(channel, best, gain / total, p))
            basis = np.column_stack([basis, direction])
    return tuple(sorted(found, key=lambda term: -term.share)[:MAX_RESIDUAL_TERMS])


def spectral_peaks(fit: Fit, filters: Mapping[str, WhiteningFilter]) -> tuple[SpectralPeak, ...]:
    """Find the strongest frequency of each channel's residual, where it exceeds what noise would give.

    Args:
        fit: the fit.
        filters: whitening filter of the residual, by channel.
    """
    found, channels = [], blocks_by_channel(fit.blocks)
    for channel, blocks in channels.items():
        interval = float(np.median(np.concatenate([np.diff(b.time) for b in blocks])))
        longest = max(float(b.time[-1] - b.time[0]) for b in blocks)
        frequencies = np.linspace(2.0 / longest, 0.45 / interval, QUARTER_OF_FREQUENCY_COUNT * 4)
        white = filters[channel]
        order = len(white.coefficients)
        power = np.zeros(len(frequencies))
        long_enough = [b for b in blocks if len(b.time) > order]  # a joint at rest leaves only a few samples
        for b in long_enough:
            power += periodogram(b.time[order:], white(b.residual), frequencies)
        best = int(np.argmax(power))
        p = min(1.0, len(channels) * len(frequencies) * float(chdtrc(2 * len(long_enough), 2 * float(power[best]))))
        if p < fit.problem.settings.verdict.term_probability:
            raw = np.concatenate([b.misfit for b in blocks])
            time = np.concatenate([b.time for b in blocks])
            wave = 2 * np.pi * frequencies[best] * time
            amplitude = 2 * np.hypot(np.mean(raw * np.cos(wave)), np.mean(raw * np.sin(wave)))
            found.append(SpectralPeak(channel, float(frequencies[best]), float(amplitude), blocks[0].unit, p))
    return tuple(found)


def periodogram(time: np.ndarray, value: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Periodogram of samples that may be unevenly spaced (Scargle, Astrophys. J. 263, 1982).

    At each frequency it is half of the decrease of the sum of squares when a sine and a cosine are fitted.

    Args:
        time: (n,) time stamps, s.
        value: (n,) samples.
        frequencies: (F,) frequencies, Hz.

    Returns:
        (F,) half of the decrease.
    """
    power = np.empty(len(frequencies))
    together = max(1, SINE_VALUES_AT_ONCE // len(time))
    for first in range(0, len(frequencies), together):
        part = slice(first, first + together)
        phase = 2 * np.pi * np.multiply.outer(frequencies[part], time)
        sine, cosine = np.sin(phase), np.cos(phase)
        s, c = sine @ value, cosine @ value
        ss, sc = np.einsum("fn,fn->f", sine, sine), np.einsum("fn,fn->f", sine, cosine)
        cc = len(time) - ss
        power[part] = (cc * s**2 - 2 * sc * s * c + ss * c**2) / np.maximum(2 * (ss * cc - sc**2), np.finfo(float).tiny)
    return power


def _library(signals: dict[str, Sequence[np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Functions of one and of two signals, each a list of arrays, one per run; scaling keeps powers distinct."""
    scale = {n: max(float(np.max(np.abs(v), initial=0.0)) for v in values) or 1.0 for n, values in signals.items()}
    library: dict[str, list[np.ndarray]] = {}
    for name, values in signals.items():
        unit = [v / scale[name] for v in values]
        shapes: dict[str, Callable[[np.ndarray], np.ndarray]] = {
            f"{name}": lambda u: u,
            f"{name}^2": lambda u: u**2,
            f"{name}^3": lambda u: u**3,
            f"|{name}| {name}": lambda u: np.abs(u) * u,
            f"sign({name})": lambda u: np.tanh(u / 0.02),
            f"[{name} > 0]": lambda u: (u > 0).astype(float),
        }
        for label, function in shapes.items():
            library[label] = [function(u) for u in unit]
    rates = [n for n in signals if n == "swing_rate" or n.startswith("v.")]
    places = [n for n in signals if n in ("swing_angle", "gripper_x") or n.startswith("q.")]
    for rate in rates:
        for place in places:
            library[f"[{place} > 0] sign({rate})"] = [
                (p > 0) * np.tanh(r / scale[rate] / 0.02) for p, r in zip(signals[place], signals[rate], strict=True)
            ]
            library[f"{place} {rate}"] = [
                p * r / scale[rate] / scale[place] for p, r in zip(signals[place], signals[rate], strict=True)
            ]
    return {
        e: v for e, v in library.items() if all(np.all(np.isfinite(x)) for x in v) and any(np.ptp(x) > 0 for x in v)
    }
