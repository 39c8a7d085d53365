"""Curves of measured over predicted signals, for every run, channel and step of a repair, and their data for a page."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from armdyn.document import Section, Widget
from armdyn.identify.bands import PredictionBands
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.residual.failing_ranges import FailingRange
from armdyn.identify.study import Study
from armdyn.recording.channel_names import channel_quantity, channel_short_name
from armdyn.recording.channels import Channel, FloatArray
from armdyn.recording.preparation import combined_preparations, preparation_sentence
from armdyn.run import Run
from pipeline.report.page import radio_buttons_html
from pipeline.report.theme import MAX_PLOTTED_POINTS, thinned_signal

MAX_CURVE_VALUES_PER_PAGE = 200_000
"""Largest number of values of all curves together: about half a megabyte in the page."""
MIN_POINTS_PER_CURVE = 300
"""Smallest number of points of each curve, however many curves there are."""

FITTED_RUN, HELD_OUT_RUN, RUN_PREDICTED_IN_TURN, EXAM_RUN = (
    "fitted",
    "held out",
    "predicted from the other runs",
    "exam",
)
RUN_ROLE_WORDS = {
    HoldoutKind.TRAINING: FITTED_RUN,
    HoldoutKind.HELD_OUT: HELD_OUT_RUN,
    HoldoutKind.LEAVE_ONE_OUT: RUN_PREDICTED_IN_TURN,
    HoldoutKind.EXAM: EXAM_RUN,
}
"""Role of a run, in words: whether the model was fitted to it."""


@dataclass(frozen=True, eq=False)
class SignalOverlay:
    """Measured signal of one channel of one run, with the residual of the model after every step of a repair.

    Attributes:
        run: name of the run.
        kind: role of the run, one of `RUN_ROLE_WORDS`.
        channel: name of the channel.
        unit: SI unit of the channel.
        time: times of the samples (n,) [s].
        measured: measured values (n,), in `unit`.
        residuals: measured minus predicted values after every step (s, n), in `unit`.
        noise: standard deviation of the measurement noise, in `unit`.
        recorded: the signal at its own rate where a filtered one is compared, else None.
        note: how the signal was processed; empty where it was not.
        failing: stretches of time where the last model's residual is far above the noise, (start, end) in s.
        half_width: (n,) half width of the band around the last model's prediction, in `unit`; None for no band.
    """

    run: str
    kind: str
    channel: str
    unit: str
    time: FloatArray
    measured: FloatArray
    residuals: FloatArray
    noise: float
    recorded: Channel | None = None
    note: str = ""
    failing: tuple[tuple[float, float], ...] = ()
    half_width: FloatArray | None = None


class PredictionQuality(NamedTuple):
    """Quality of a model's prediction: error, and explained share of the measured signal.

    Attributes:
        rmse: root mean square error; for several channels, the root of the sum of their mean squares.
        explained: explained share of the measured signal's variation about its mean in each run; 1 is all of it, and a
            negative value is worse than a prediction of the mean.
    """

    rmse: float
    explained: float

    @property
    def rounded(self) -> list[float | None]:
        """Both numbers rounded for JSON; None where one is not finite."""
        return [round(value, 12) if np.isfinite(value) else None for value in self]


def prediction_quality(curves: Iterable[SignalOverlay], step: int) -> PredictionQuality:
    """Error and explained share of a model on curves of one unit.

    Args:
        curves: curves to compare, of any runs and channels.
        step: index of the step of a repair whose model is judged.
    """
    left: dict[str, float] = {}
    samples: dict[str, int] = {}
    varied = 0.0
    for c in curves:
        left[c.channel] = left.get(c.channel, 0.0) + float(np.sum(c.residuals[step] ** 2))
        samples[c.channel] = samples.get(c.channel, 0) + len(c.time)
        varied += float(np.sum((c.measured - c.measured.mean()) ** 2))
    squares = sum(left[channel] / samples[channel] for channel in left)
    return PredictionQuality(
        float(np.sqrt(squares)), 1.0 - sum(left.values()) / varied if varied > 0.0 else float("nan")
    )


def study_overlays(
    study: Study, fits: Sequence[Fit], places: Sequence[FailingRange] = (), bands: PredictionBands | None = None
) -> list[SignalOverlay]:
    """Overlays of all runs of a study: training runs, then held-out runs, then exam runs.

    Args:
        study: runs and model.
        fits: fit of the given model, then of the model after every step.
        places: intervals (of time, or of a covariate) in which the last model fails.
        bands: uncertainty bands around the last model's predictions.
    """
    others = RUN_ROLE_WORDS[study.holdout_kinds[-1]]
    found = training_overlays(fits, places)
    if others != FITTED_RUN:
        found += _overlays(study.held_out or study.runs, others, [study.held_out_blocks(fit) for fit in fits])
    if study.exam:
        found += _overlays(study.exam, EXAM_RUN, [study.exam_blocks(fit) for fit in fits])
    if bands is None:
        return found
    return [replace(curve, half_width=bands.half_width.get((curve.run, curve.channel))) for curve in found]


def training_overlays(fits: Sequence[Fit], places: Sequence[FailingRange] = ()) -> list[SignalOverlay]:
    """Overlays of the training runs of fits; see `study_overlays` for the arguments."""
    return _overlays(fits[0].problem.runs, FITTED_RUN, [fit.blocks for fit in fits], places)


def _overlays(
    runs: Iterable[Run], kind: str, steps: Sequence[Sequence[ResidualBlock]], places: Sequence[FailingRange] = ()
) -> list[SignalOverlay]:
    by_name = {run.name: run for run in runs}
    misfits = [{(block.run, block.channel): block.misfit for block in blocks} for blocks in steps]
    failing: dict[tuple[str | None, str], list[tuple[float, float]]] = {}
    for place in places:
        if place.against == "time":
            failing.setdefault((place.run, place.channel), []).append((place.start, place.end))
    found = []
    for block in steps[0]:
        key, run = (block.run, block.channel), by_name[block.run]
        done = run.preparations.get(block.channel)
        note = (
            f"Compared below {done.cutoff:.3g} Hz: {done.samples} samples, {done.rate:.3g} per second, of "
            f"{done.recorded} recorded."
            if done is not None
            else ""
        )
        recorded = run.recording.channels[block.channel] if done is not None else None
        residuals = np.array([misfit[key] for misfit in misfits])
        found.append(
            SignalOverlay(
                run.name, kind, block.channel, block.unit, block.time, block.measured.value, residuals, block.noise,
                recorded, note, tuple(failing.get(key, ())),
            )
        )  # fmt: skip
    return found


@dataclass(frozen=True)
class OverlayFigure:
    """Interactive figure of measured and predicted signals; the reader chooses channel, run and step of a repair.

    Attributes:
        curves: curves of every run and channel.
        steps: name of every step, the model as given first.
        preparation: sentence on how the signals were processed.
    """

    curves: Sequence[SignalOverlay]
    steps: Sequence[str] = ("as given",)
    preparation: str = ""

    @classmethod
    def of_study(
        cls,
        study: Study,
        fits: Sequence[Fit],
        steps: Sequence[str],
        places: Sequence[FailingRange],
        bands: PredictionBands | None = None,
    ) -> "OverlayFigure":
        """Figure of all runs of a study; see `study_overlays` for the arguments."""
        done = preparation_sentence(combined_preparations(run.preparations for run in fits[-1].problem.runs))
        return cls(study_overlays(study, fits, places, bands), steps, done)

    def section(self) -> Section:
        """Section with the figure, its controls, and a note on how the signals were processed."""
        text = "Choose a step, and see what it changes." if len(self.steps) > 1 else ""
        if any(curve.failing for curve in self.curves):
            text += " Shaded: where the residual is far above the noise."
        text = f"{text} {self.preparation}".strip()
        return Section("Measured and predicted", text, tabs=self.tabs, widget=self.widget())

    @property
    def tabs(self) -> Mapping[str, str]:
        """Title of each channel's tab, by channel, in the order of the recordings."""
        return {curve.channel: channel_short_name(curve.channel) for curve in self.curves}

    @property
    def points(self) -> int:
        """Number of points to which each curve is thinned, so that the page stays small."""
        rows = sum(2 + len(curve.residuals) + (2 if curve.recorded is not None else 0) for curve in self.curves)
        return int(np.clip(MAX_CURVE_VALUES_PER_PAGE // max(rows, 1), MIN_POINTS_PER_CURVE, MAX_PLOTTED_POINTS))

    def widget(self) -> Widget:
        """HTML of the controls, and the curves as data for the page's script."""
        first, points = self._shown_first(), self.points
        runs = list(dict.fromkeys((curve.run, curve.kind) for curve in self.curves))
        labels = [name if kind == FITTED_RUN else f"{name} · {kind}" for name, kind in runs]
        steps = _pills("step", "Step", self.steps, len(self.steps) - 1)
        controls = steps + _pills("run", "Run", labels, runs.index((first.run, first.kind)))
        data = {
            "steps": list(self.steps),
            "start": {"run": first.run, "kind": first.kind, "channel": first.channel},
            "curves": [_packed(curve, points) for curve in self.curves],
            "channels": {
                curve.channel: {
                    "quantity": channel_quantity(curve.channel, curve.unit),
                    "name": channel_short_name(curve.channel),
                }
                for curve in self.curves
            },
            "totals": self.totals(),
        }
        html = f"<div class='controls'>{controls}</div><p class='readout' aria-live='polite'></p>"
        return Widget(html, data, height=460)

    def totals(self) -> dict[str, dict[str, list[list[float | None]]]]:
        """Error and explained share after every step, by role of the runs and by channel."""
        found: dict[str, dict[str, list[list[float | None]]]] = {}
        for kind, channel in dict.fromkeys((curve.kind, curve.channel) for curve in self.curves):
            mine = [c for c in self.curves if (c.kind, c.channel) == (kind, channel)]
            found.setdefault(kind, {})[channel] = [
                prediction_quality(mine, step).rounded for step in range(len(self.steps))
            ]
        return found

    def _shown_first(self) -> SignalOverlay:
        """The curve that is shown first: of the most independent runs, the channel that the steps improve most."""
        choices = [curve for curve in self.curves if curve.kind == self.curves[-1].kind]

        def gain(curve: SignalOverlay) -> float:
            squares = np.mean(curve.residuals**2, axis=1)
            return float(squares[0] - squares[-1] if len(squares) > 1 else squares[0] / curve.noise**2)

        return max(choices, key=gain) if len({curve.unit for curve in choices}) == 1 else choices[0]


def _pills(kind: str, legend: str, labels: Sequence[str], chosen: int) -> str:
    options = {
        f"data-control='{kind}' value='{i}'{' checked' if i == chosen else ''}": label for i, label in enumerate(labels)
    }
    return radio_buttons_html(kind, legend, kind, options)


def last_step_curve_data(curve: SignalOverlay, most: int) -> dict[str, Any]:
    """Residual, error and explained share of a curve's last step, as data for the page's script.

    Args:
        curve: curve whose last step was computed again.
        most: largest number of points of the curve.
    """
    rmse, explained = prediction_quality([curve], -1).rounded
    return {"residual": quantised(curve.residuals[-1][_every(curve, most)]), "rmse": rmse, "explained": explained}


def _every(curve: SignalOverlay, most: int) -> slice:
    return slice(None, None, -(-len(curve.time) // most))


def _packed(curve: SignalOverlay, most: int) -> dict[str, Any]:
    every = _every(curve, most)
    rmse, explained = zip(
        *(prediction_quality([curve], step).rounded for step in range(len(curve.residuals))), strict=True
    )
    return {
        **{name: getattr(curve, name) for name in ("run", "kind", "channel", "unit", "noise", "note", "failing")},
        "time": quantised(curve.time[every]),
        "measured": quantised(curve.measured[every]),
        "residuals": [quantised(residual[every]) for residual in curve.residuals],
        "rmse": rmse,
        "explained": explained,
        "band": None if curve.half_width is None else quantised(curve.half_width[every]),
        "recorded": None
        if curve.recorded is None
        else [quantised(row) for row in thinned_signal(curve.recorded.time, curve.recorded.value, most)],
    }


def quantised(values: FloatArray) -> list[Any]:
    """Values (n,) rounded to 65,536 equal steps from the smallest to the largest, for a small page.

    Returns:
        Smallest value, size of a step, and the steps in base64 of unsigned little-endian 16-bit integers.
    """
    low, high = float(np.min(values)), float(np.max(values))
    step = (high - low) / 65535 or 1.0
    with np.errstate(invalid="ignore"):  # residuals of a simulation that diverges are not finite, and not drawn
        steps = np.round((values - low) / step).astype("<u2")
    return [low, step, base64.b64encode(steps.tobytes()).decode()]
