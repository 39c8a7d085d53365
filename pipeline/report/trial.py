"""The report of one trial: what was learnt, how well the arm followed, how the load swung, and the verdict."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from armdyn.document import Chart, Document, KeyFigure, Level, NextStep, Section
from pipeline.box import Box
from pipeline.motion.feasibility import Margin
from pipeline.nodes.scheduler import Timing
from pipeline.report.feasibility import margin_section
from pipeline.report.motion import (
    EstimateTrace,
    ForceTrace,
    GripperTrace,
    JointTrace,
    estimate_section,
    force_section,
    gripper_section,
    position_section,
    timing_section,
    velocity_section,
)
from pipeline.report.theme import ACTUAL, BLUE, FAINT, GREY, INK, REFERENCE, Span, number, percent


@dataclass(frozen=True)
class SwingTrace:
    """Gripper and load in the vertical plane of the line during the swing.

    Attributes:
        time: (n,) [s].
        gripper_x: (n,) [m] along the line.
        load_x: (n,) [m] along the line.
        load_z: (n,) [m] over the line, negative below.
    """

    time: FloatArray
    gripper_x: FloatArray
    load_x: FloatArray
    load_z: FloatArray


@dataclass(frozen=True)
class SwingPicture:
    """The planned swing and what became of it.

    Attributes:
        planned: from the optimiser.
        executed: as measured or simulated; None where the swing was not run.
        box: None where there is none.
        load_radius: [m].
        snapshots: how many positions of the string are drawn.
    """

    planned: SwingTrace
    executed: SwingTrace | None
    box: Box | None
    load_radius: float = 0.014
    snapshots: int = 9


def swing_section(swing: SwingPicture) -> Section:
    """Paths of gripper and load, with snapshots of the string, to scale."""
    shown = swing.executed or swing.planned
    figure = go.Figure(layout={"height": 520, "hovermode": "closest"})
    _add_strings(figure, shown, swing.snapshots, swing.load_radius)
    if swing.box is not None:
        _add_box(figure, swing.box)
    figure.add_scatter(
        x=shown.gripper_x, y=0 * shown.gripper_x, name="gripper", mode="lines", line={"color": INK, "width": 3}
    )
    if swing.executed is not None:
        figure.add_scatter(x=swing.executed.load_x, y=swing.executed.load_z, name="load, executed", **ACTUAL)
    figure.add_scatter(x=swing.planned.load_x, y=swing.planned.load_z, name="load, planned", **REFERENCE)
    figure.update_layout(
        xaxis={"title": {"text": "along the line [m]"}},
        yaxis={"title": {"text": "height over the line [m]"}, "scaleanchor": "x"},
    )
    kind = "executed" if swing.executed is not None else "planned"
    caption = f"To scale. Thin lines: the string at {swing.snapshots} equally spaced times, {kind}."
    return Section("Swing", _missed(swing.planned, swing.executed), [Chart(figure, caption)])


def _missed(planned: SwingTrace, executed: SwingTrace | None) -> str:
    """How far the executed load was from the planned one where the plan ends."""
    if executed is None:
        return "The swing was planned and not executed."
    end = float(planned.time[-1])
    if executed.time[-1] < end:
        return f"The swing was stopped after {executed.time[-1] - executed.time[0]:.2f} s, before the plan's end."
    across = np.interp(end, executed.time, executed.load_x) - planned.load_x[-1]
    up = np.interp(end, executed.time, executed.load_z) - planned.load_z[-1]
    return (
        f"Where the plan ends the load was {number(float(np.hypot(across, up)), 'm', 2)} from its planned place "
        f"({number(float(across), 'm', 2)} along the line, {number(float(up), 'm', 2)} up)."
    )


def _add_strings(figure: go.Figure, trace: SwingTrace, count: int, radius: float) -> None:
    """The string as one broken line, and the load as discs of its true size."""
    times = np.linspace(trace.time[0], trace.time[-1], count)
    gripper, x, z = (np.interp(times, trace.time, path) for path in (trace.gripper_x, trace.load_x, trace.load_z))
    gap = np.full(count, np.nan)
    line: dict[str, Any] = {"color": GREY, "width": 1}
    figure.add_scatter(
        x=np.stack([gripper, x, gap], axis=1).ravel(),
        y=np.stack([0 * z, z, gap], axis=1).ravel(),
        name="string",
        mode="lines",
        line=line,
        hoverinfo="skip",
    )
    for i in range(count):
        disc = {"type": "circle", "x0": x[i] - radius, "x1": x[i] + radius, "y0": z[i] - radius, "y1": z[i] + radius}
        figure.add_shape(**disc, line=line, fillcolor=BLUE, opacity=0.25 + 0.6 * i / max(count - 1, 1), layer="below")


def _add_box(figure: go.Figure, box: Box) -> None:
    near, far = box.near_wall, box.near_wall + box.width
    rim, floor = -box.rim, -box.rim - box.height
    figure.add_scatter(
        x=[near, near, far, far],
        y=[rim, floor, floor, rim],
        name="box",
        mode="lines",
        line={"color": INK, "width": 4},
        fill="toself",
        fillcolor=FAINT,
    )


@dataclass(frozen=True)
class TrialReportData:
    """Everything the report of one trial shows; a part that is None or empty is left out.

    Attributes:
        level: colour of the verdict.
        verdict: what happened, in a sentence.
        subtitle: robot, load, seed, hidden effects.
        command: how to run this trial again.
        phases: named stretches of time.
        notes: sentences to read first, such as warnings.
        key_figures: numbers beside those that follow from the other parts.
        estimates: the parameters learnt, the length first.
        force, gripper, swing, joints: recordings of the trial.
        margins: to the limits; the tightest need not come first.
        nodes: computing times.
        next_steps: what to do now.
        investigation: what the robot found out before the swing.
    """

    level: Level
    verdict: str
    subtitle: str = ""
    command: str = ""
    phases: tuple[Span, ...] = ()
    notes: tuple[str, ...] = ()
    key_figures: tuple[KeyFigure, ...] = ()
    estimates: tuple[EstimateTrace, ...] = ()
    force: ForceTrace | None = None
    gripper: GripperTrace | None = None
    swing: SwingPicture | None = None
    joints: JointTrace | None = None
    margins: tuple[Margin, ...] = ()
    nodes: tuple[Timing, ...] = ()
    next_steps: tuple[NextStep, ...] = ()
    investigation: Section | None = None


def trial_report(data: TrialReportData) -> Document:
    """The report of one trial."""
    return Document(
        title="Trial: learn the string, swing the load",
        level=data.level,
        verdict=data.verdict,
        sections=_sections(data),
        subtitle=data.subtitle,
        key_figures=(*_key_figures(data), *data.key_figures),
        notes=data.notes,
        command=data.command,
        next_steps=data.next_steps,
    )


def _sections(data: TrialReportData) -> list[Section]:
    sections: list[Section] = []
    if data.swing is not None:
        sections.append(swing_section(data.swing))
    if data.investigation is not None:
        sections.append(data.investigation)
    if data.estimates:
        white = data.force.residual_is_white if data.force is not None else None
        sections.append(estimate_section(data.estimates, data.phases, white))
    if data.force is not None:
        sections.append(force_section(data.force, data.phases))
    if data.gripper is not None:
        sections.append(gripper_section(data.gripper, data.phases))
    if data.joints is not None:
        sections += [position_section(data.joints), velocity_section(data.joints)]
    if data.margins:
        sections.append(margin_section(data.margins))
    if data.nodes:
        sections.append(timing_section(data.nodes))
    return sections


def _key_figures(data: TrialReportData) -> list[KeyFigure]:
    figures = []
    doubt = "; does not hold" if data.force is not None and data.force.residual_is_white is False else ""
    for trace in data.estimates[:1]:
        if trace.value.size:
            spread, guess = number(trace.std[-1], trace.unit, 2), number(trace.guess, trace.unit)
            value = f"{trace.value[-1]:.4f} {trace.unit}"
            figures.append(KeyFigure(f"Estimated {trace.name}", value, f"± {spread}{doubt}, from a guess of {guess}"))
            if trace.truth is not None:
                error = trace.value[-1] - trace.truth
                note = f"{abs(error) / trace.std[-1]:.1f} reported standard deviations" if trace.std[-1] > 0 else ""
                figures.append(KeyFigure("Error", number(error, trace.unit, 2), note))
    if data.force is not None:
        least = float(np.nanmin(data.force.measured))
        figures.append(
            KeyFigure("Least tension", number(least, "N"), "the string went slack" if least <= 0.0 else "taut")
        )
    if data.gripper is not None:
        error = float(np.sqrt(np.nanmean((data.gripper.actual - data.gripper.reference) ** 2)))
        figures.append(KeyFigure("Gripper error", number(error, "m", 2), "rms along the line"))
    if data.margins:
        tightest = max(data.margins, key=lambda margin: margin.used)
        figures.append(KeyFigure("Tightest limit", percent(tightest.used), f"{tightest.limit}, {tightest.joint}"))
    return figures
