"""Report of the command `inspect`: defects of recordings, and every channel over time with its power spectrum."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armdyn.document import Chart, Column, Document, ResultLevel, Section, Table, attribute_columns
from armdyn.inspection.check import Check, Inspection, Severity
from armdyn.recording.channels import Channel
from armdyn.run import Run
from pipeline.report.theme import BLUE, ORANGE, TIME_AXIS, thinned_signal

MAX_CHANNEL_CURVE_POINTS = 1500
"""Largest number of drawn samples of a channel; the extremes of each stretch are kept."""
CHANNEL_CHART_HEIGHT_PIXELS = 230
"""Height of a channel's figure [px]."""


def inspection_document(found: Inspection) -> Document:
    """Document of an inspection of recordings: a table of its findings."""
    level = (
        ResultLevel.BAD
        if not found.usable
        else ResultLevel.CAUTION
        if found.with_severity(Severity.SUSPECT)
        else ResultLevel.GOOD
    )
    return Document("Inspection", found.sentence, [checks_section(found.checks)] if found.checks else [], level)


def inspection_report(found: Inspection) -> Document:
    """Report of an inspection: a table of its findings, and a figure of every channel of every recording."""
    return replace(
        inspection_document(found),
        sections=[checks_section(found.checks), *(run_channels_section(run, found.checks) for run in found.runs)],
        subtitle=", ".join(run.name for run in found.runs),
    )


def checks_section(checks: Sequence[Check]) -> Section:
    """Section with a table of an inspection's findings: severity, channels, time, sentence and remedy."""
    if not checks:
        return Section("Checks", "Nothing was found: every channel and every rate is as it should be.")
    runs: dict[Check, list[str]] = {}
    for check in checks:  # the same finding in several runs is one row
        runs.setdefault(replace(check, run=None, correction=None), []).append(check.run or "")
    checks = list(runs)
    columns = [
        Column("severity", [c.severity.key for c in checks], title=" "),
        *attribute_columns(checks, kind=""),
        Column("run", [", ".join(names) for names in runs.values()]),
        Column("channels", [", ".join(c.channels[:4]) for c in checks], dropped_when_narrow=True),
        Column("from, to [s]", [_span(c) for c in checks], dropped_when_narrow=True),
        Column("what", [c.sentence for c in checks]),
        *attribute_columns(checks, remedy=""),
    ]
    return Section("Checks", tables=[Table(columns)])


def _span(check: Check) -> str:
    return "" if check.start is None or check.end is None else f"{check.start:.4g}, {check.end:.4g}"


def run_channels_section(run: Run, checks: Sequence[Check]) -> Section:
    """Section with a figure of every channel of a recording, in which the findings' stretches of time are marked."""
    charts = [
        channel_chart(name, c, [k for k in checks if k.run == run.name and name in k.channels])
        for name, c in run.channels.items()
    ]
    return Section(run.name, run.description, charts)


def channel_chart(name: str, channel: Channel, checks: Sequence[Check]) -> Chart:
    """Figure of one channel over time, with its findings' stretches of time marked, and of its power spectrum."""
    from plotly.subplots import make_subplots

    figure = make_subplots(1, 2, column_widths=[0.7, 0.3], horizontal_spacing=0.09)
    time, value = thinned_signal(channel.time, channel.value, MAX_CHANNEL_CURVE_POINTS)
    figure.add_scatter(
        x=time, y=value, mode="lines", line={"width": 1}, marker={"color": BLUE}, name=name, row=1, col=1
    )
    for check in checks:
        if check.start is not None and check.end is not None:
            figure.add_vrect(
                x0=check.start, x1=max(check.end, check.start + 1e-3), fillcolor=ORANGE, opacity=0.25, line_width=0,
                annotation_text=check.kind, annotation_position="top left", row=1, col=1,
            )  # fmt: skip
    frequency, density = power_spectrum(channel)
    figure.add_scatter(x=frequency, y=density, mode="lines", line={"width": 1}, name="spectrum", row=1, col=2)
    figure.update_xaxes(title_text=TIME_AXIS, row=1, col=1)
    figure.update_xaxes(title_text="frequency [Hz]", type="log", row=1, col=2)
    figure.update_yaxes(title_text=f"{name} [{channel.unit}]", row=1, col=1)
    figure.update_yaxes(title_text=f"[({channel.unit})^2/Hz]", type="log", row=1, col=2)
    figure.update_layout(height=CHANNEL_CHART_HEIGHT_PIXELS, showlegend=False, margin={"t": 16, "b": 44})
    caption = " ".join(f"{check.severity.key}: {check.sentence}." for check in checks)
    return Chart(figure, caption)


def power_spectrum(channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and one-sided power spectral density of a channel without its mean, on a logarithmic grid."""
    from scipy.signal import periodogram

    time = np.linspace(channel.time[0], channel.time[-1], max(len(channel), 16))
    value = np.interp(time, channel.time, channel.value)
    frequency, power = periodogram(value, 1.0 / (time[1] - time[0]), "hann")
    frequency, power = frequency[1:], power[1:]
    edges = np.unique(np.geomspace(1, len(frequency), 200).astype(int)) - 1
    counts = np.diff(np.append(edges, len(frequency)))
    mean = np.add.reduceat(power, edges) / counts
    return np.add.reduceat(frequency, edges) / counts, np.maximum(mean, 1e-300)
