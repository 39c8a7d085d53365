"""Measured and predicted over each other, for every run, channel and step of a repair."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import Any

import numpy as np

from armdyn.channels import Channel, FloatArray
from armdyn.document import Section, Widget
from armdyn.identify.fit import Fit
from armdyn.identify.localise import Place
from armdyn.identify.problem import Block
from armdyn.identify.study import Study
from armdyn.identify.unseen import Judge
from armdyn.preparation import of_all_runs, sentence
from armdyn.run import Run
from pipeline.report.theme import MOST_POINTS, quantity_of, short_name, thinned

MOST_VALUES = 200_000
"""Of all curves together: about half a megabyte in the page."""
LEAST_POINTS = 300

FITTED, HELD_OUT, IN_TURN, EXAM = "fitted", "held out", "predicted from the other runs", "exam"
KINDS = {Judge.TRAINING: FITTED, Judge.HELD_OUT: HELD_OUT, Judge.IN_TURN: IN_TURN, Judge.EXAM: EXAM}
"""What a run was to the model whose prediction is shown."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """One channel of one run, with what the model of every step leaves of it.

    Attributes:
        run: its name.
        kind: what part it took, one of `KINDS`.
        channel: its name.
        unit: SI.
        time: (n,) s.
        measured: (n,) in `unit`.
        residuals: (s, n) measured minus predicted at every step, in `unit`.
        noise: standard deviation, in `unit`.
        recorded: the signal at its own rate where a filtered one is compared, else None.
        note: what was done to the signal; empty for nothing.
        failing: stretches of time where the last model's residual is far above the noise, (start, end) in s.
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


@dataclass(frozen=True)
class Quality:
    """How well a model does.

    Attributes:
        rmse: root mean square error; of several channels the root of their summed squares.
        explained: share of the measured signal's variation about its mean in each run, 1 = all; negative where the
            mean alone would do better.
    """

    rmse: float
    explained: float


def quality(curves: Iterable[Overlay], step: int) -> Quality:
    """Of one step's model on these curves, which have one unit."""
    left: dict[str, float] = {}
    samples: dict[str, int] = {}
    varied = 0.0
    for c in curves:
        left[c.channel] = left.get(c.channel, 0.0) + float(np.sum(c.residuals[step] ** 2))
        samples[c.channel] = samples.get(c.channel, 0) + len(c.time)
        varied += float(np.sum((c.measured - c.measured.mean()) ** 2))
    squares = sum(left[channel] / samples[channel] for channel in left)
    return Quality(float(np.sqrt(squares)), 1.0 - sum(left.values()) / varied if varied > 0.0 else float("nan"))


def overlays(study: Study, fits: Sequence[Fit], places: Sequence[Place] = ()) -> list[Overlay]:
    """Every run of a study with what these fits leave: those that were fitted, then held-out runs, then exam runs.

    Args:
        study: runs and model.
        fits: of the model as given, then of every step.
        places: where the last one fails.
    """
    others = KINDS[study.judges[-1]]
    found = of_fits(fits, places)
    if others != FITTED:
        held_out = [study.held_out_blocks(fit) or [] for fit in fits]
        found += _overlays(study.held_out or study.runs, others, held_out, ())
    if study.exam:
        found += _overlays(study.exam, EXAM, [study.exam_blocks(fit) for fit in fits], ())
    return found


def of_fits(fits: Sequence[Fit], places: Sequence[Place] = ()) -> list[Overlay]:
    """The training runs alone."""
    problem = fits[0].problem
    return _overlays(problem.runs, FITTED, [list(fit.blocks) for fit in fits], places)


def _overlays(
    runs: Sequence[Run], kind: str, steps: Sequence[Sequence[Block]], places: Sequence[Place]
) -> list[Overlay]:
    by_name = {run.name: run for run in runs}
    later = [{(b.run, b.channel): b for b in blocks} for blocks in steps]
    return [
        _overlay(by_name[first.run], kind, first, [blocks[first.run, first.channel] for blocks in later], places)
        for first in steps[0]
    ]


def _overlay(run: Run, kind: str, first: Block, steps: Sequence[Block], places: Sequence[Place]) -> Overlay:
    channel = run.channels[first.channel]
    done = run.preparations.get(first.channel)
    note = (
        ""
        if done is None
        else f"Compared below {done.cutoff:.3g} Hz: {done.samples} samples, {done.rate:.3g} per second, of "
        f"{done.recorded} recorded."
    )
    return Overlay(
        run=run.name,
        kind=kind,
        channel=first.channel,
        unit=channel.unit,
        time=first.time,
        measured=np.interp(first.time, channel.time, channel.value),
        residuals=np.array([block.misfit for block in steps]),
        noise=first.noise,
        recorded=None if done is None else run.recording.channels[first.channel],
        note=note,
        failing=tuple(
            (place.start, place.end)
            for place in places
            if place.against == "time" and place.run == run.name and place.channel == first.channel
        ),
    )


@dataclass(frozen=True)
class Overlays:
    """All curves of a page: tabs for the channels, a switch for the steps, a choice of runs, and their curves.

    Attributes:
        curves: every run and channel.
        steps: name of every step, the model as given first.
        preparation: what was done to the signals, for a person.
    """

    curves: Sequence[Overlay]
    steps: Sequence[str] = ("as given",)
    preparation: str = ""

    @classmethod
    def of_study(cls, study: Study, fits: Sequence[Fit], steps: Sequence[str], places: Sequence[Place]) -> "Overlays":
        """All runs of a study."""
        problem = fits[-1].problem
        done = sentence(of_all_runs(run.preparations for run in problem.runs))
        return cls(overlays(study, fits, places), steps, done)

    def section(self) -> Section:
        """With what to click, and what was done to the signals."""
        text = "Choose a step, and see what it changes." if len(self.steps) > 1 else ""
        if any(curve.failing for curve in self.curves):
            text += " Shaded: where the residual is far above the noise."
        sentence = f"{text} {self.preparation}".strip()
        return Section("Measured and predicted", sentence, tabs=self.tabs(), widget=self.widget())

    @cached_property
    def points(self) -> int:
        """Most points of each curve."""
        return _points(self.curves)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """In the order of the recordings."""
        return tuple(dict.fromkeys(curve.channel for curve in self.curves))

    def widget(self) -> Widget:
        """The controls, and the data that they choose from."""
        start = self._most_improved()
        html = (
            f"<div class='controls'>{_pills('step', 'Step', list(self.steps), len(self.steps) - 1)}"
            f"{self._runs(start)}</div><p class='readout' aria-live='polite'></p>"
        )
        return Widget(html, self.data(), height=460)

    def tabs(self) -> Mapping[str, str]:
        """The channels."""
        return {channel: short_name(channel) for channel in self.channels}

    def data(self) -> dict[str, Any]:
        """What the page's script draws."""
        points = self.points
        return {
            "steps": list(self.steps),
            "start": self._most_improved(),
            "curves": [_packed(curve, points) for curve in self.curves],
            "channels": {
                curve.channel: {"quantity": quantity_of(curve.channel, curve.unit), "name": short_name(curve.channel)}
                for curve in self.curves
            },
            "totals": self.totals(),
        }

    def _runs(self, start: Mapping[str, Any]) -> str:
        runs = list(dict.fromkeys((curve.run, curve.kind) for curve in self.curves))
        labels = [name if kind == FITTED else f"{name} · {kind}" for name, kind in runs]
        return _pills("run", "Run", labels, runs.index((start["run"], start["kind"])))

    def _most_improved(self) -> dict[str, Any]:
        """Run, kind and channel to begin with: of the most independent runs the channel that the steps help most."""
        last = self.curves[-1].kind
        choices = [curve for curve in self.curves if curve.kind == last]

        def gain(curve: Overlay) -> float:
            squares = np.mean(curve.residuals**2, axis=1)
            return float(squares[0] - squares[-1] if len(squares) > 1 else squares[0] / curve.noise**2)

        one_unit = len({curve.unit for curve in choices}) == 1
        best = max(choices, key=gain) if one_unit else choices[0]
        return {"run": best.run, "kind": best.kind, "channel": best.channel}

    def totals(self) -> dict[str, dict[str, list[list[float | None]]]]:
        """By kind and channel: error and share explained at every step."""
        found: dict[str, dict[str, list[list[float | None]]]] = {}
        for kind in dict.fromkeys(curve.kind for curve in self.curves):
            found[kind] = {}
            for channel in self.channels:
                mine = [c for c in self.curves if c.kind == kind and c.channel == channel]
                if mine:
                    each = [quality(mine, step) for step in range(len(self.steps))]
                    found[kind][channel] = [[_finite(q.rmse), _finite(q.explained)] for q in each]
        return found


def _pills(name: str, legend: str, labels: Sequence[str], chosen: int) -> str:
    """Radio buttons in a row; none where there is nothing to choose."""
    if len(labels) < 2:
        return ""
    buttons = "".join(
        f"<label><input type='radio' name='{name}' data-control='{name}' value='{i}'"
        f"{' checked' if i == chosen else ''}><span>{escape(label)}</span></label>"
        for i, label in enumerate(labels)
    )
    return f"<fieldset class='pills {name}'><legend>{legend}</legend>{buttons}</fieldset>"


def _points(curves: Sequence[Overlay]) -> int:
    """Most points of each curve, so that all together are not too many for a page."""
    rows = sum(2 + len(curve.residuals) + (2 if curve.recorded is not None else 0) for curve in curves)
    return int(np.clip(MOST_VALUES // max(rows, 1), LEAST_POINTS, MOST_POINTS))


def changed(curve: Overlay, most: int) -> dict[str, Any]:
    """What the page's script needs of a curve whose last step was computed again."""
    last = quality([curve], -1)
    return {
        "residual": quantised(curve.residuals[-1][_every(curve, most)]),
        "rmse": _finite(last.rmse),
        "explained": _finite(last.explained),
    }


def _every(curve: Overlay, most: int) -> slice:
    return slice(None, None, -(-len(curve.time) // most))


def _packed(curve: Overlay, most: int) -> dict[str, Any]:
    every = _every(curve, most)
    steps = range(len(curve.residuals))
    each = [quality([curve], step) for step in steps]
    return {
        "run": curve.run,
        "kind": curve.kind,
        "channel": curve.channel,
        "unit": curve.unit,
        "noise": curve.noise,
        "note": curve.note,
        "failing": [list(stretch) for stretch in curve.failing],
        "time": quantised(curve.time[every]),
        "measured": quantised(curve.measured[every]),
        "residuals": [quantised(residual[every]) for residual in curve.residuals],
        "rmse": [_finite(q.rmse) for q in each],
        "explained": [_finite(q.explained) for q in each],
        "recorded": None if curve.recorded is None else [quantised(row) for row in thinned(curve.recorded, most)],
    }


def quantised(values: FloatArray) -> list[Any]:
    """(n,) values as 16-bit steps between the smallest and the largest: finer than a screen, a quarter of the size.

    Returns:
        Smallest value, size of a step, and the steps in base64 of unsigned little-endian 16-bit integers.
    """
    low, high = float(np.min(values)), float(np.max(values))
    step = (high - low) / 65535 or 1.0
    steps = np.round((values - low) / step).astype("<u2")
    return [low, step, base64.b64encode(steps.tobytes()).decode()]


def _finite(value: float) -> float | None:
    return round(value, 12) if np.isfinite(value) else None
