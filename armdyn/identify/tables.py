"""Tables that comparison, diagnosis and repair share: parameters, channels, samples and missing forces."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.document import Column, Columns, Curve, Section, Table, attribute_columns
from armdyn.identify.explained_share import ChannelScale, RepairStep
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.residual.failing_ranges import FailingRange
from armdyn.identify.residual.missing_force import ForceCurve
from armdyn.identify.sentence import MAX_NAMED_JOINTS, total_errors
from armdyn.parameter import Parameter
from armdyn.recording.channel_names import channel_full_name

if TYPE_CHECKING:
    from armdyn.arm.closed_loop.rollout import SimulatedPositionError
    from armdyn.arm.drives import Servo
    from armdyn.arm.links import LinkInertiaChange
    from armdyn.identify.bands import PredictionBands
    from armdyn.identify.study import Study

MAX_LISTED_VALUES = 6
"""Largest number of values of an effect that a table of candidates lists."""
SURPRISING_STDS = 3.0
"""Standard deviations by which an identified gain differs from the stated one if a sentence says so."""
MAX_LISTED_FAILING_RANGES = 6
"""Largest number of ranges in a table of where a model fails."""
ROLE_REMARKS = {"training": "", "held_out": " (held out)", "exam": " (exam)"}
"""What follows the name of a run in a figure, by the run's role."""
LINK_WORDS = {"mass": "mass", "centre": "centre of mass", "inertia": "inertia", "moment": "mass times centre"}
"""Quantity of a link in words, by the first part of the quantity's name."""


def parameter_table(found: Mapping[str, Parameter]) -> Table:
    """Table of the values and standard deviations of parameters, given by name."""
    values = found.values()
    columns = [
        Column("parameter", list(found)),
        *attribute_columns(values, value=".6g"),
        Column("std", [_std(p) for p in values], ".2g", missing_text="fixed"),
        *attribute_columns(values, unit=""),
        Column("fitted", [p.fitted for p in values], dropped_when_narrow=True),
        Column("what it is", [p.source for p in values], dropped_when_narrow=True),
    ]
    return Table(columns, name="parameters")


def _std(parameter: Parameter) -> float | str | None:
    return "not known" if parameter.fitted and parameter.std is None else parameter.std


def channel_table(found: Mapping[str, Any], caption: str) -> Table:
    """Table of how well each channel is predicted.

    Args:
        found: quality of each channel by its name, with the attributes of `ChannelQuality`.
        caption: processing of the signals, in words.
    """
    values = list(found.values())
    unseen = {"exam_rmse": ".4g"} if any(c.exam_rmse is not None for c in values) else {}
    columns = [
        Column("channel", list(found)),
        *attribute_columns(values, unit="", noise_std=".3g", rmse=".4g", held_out_rmse=".4g", **unseen),
        Column("chi2_per_sample", [c.chi2_per_sample for c in values], title="χ² per sample"),
        Column("p of white noise", [c.whiteness_p_value for c in values], ".2g", dropped_when_narrow=True),
    ]
    return Table(columns, caption, "channels", "Statistics: noise, errors, χ² per sample, whiteness")


def failing_range_section(places: Sequence[FailingRange], units: Mapping[str, str]) -> Section:
    """Section on the ranges of time, angle or speed in which a model fails, the worst first.

    Args:
        places: the ranges.
        units: unit of each channel.
    """
    worst = places[:MAX_LISTED_FAILING_RANGES]
    columns = [
        Column("channel", [channel_full_name(place.channel, units[place.channel]) for place in worst]),
        Column("where", [place.quantity for place in worst]),
        Column("from", [place.start for place in worst], ".3g"),
        Column("to", [place.end for place in worst], ".3g"),
        *attribute_columns(worst, unit=""),
        Column("run", [place.run or "all" for place in worst]),
        Column("χ² per sample", [place.chi2_per_sample for place in worst], ".3g"),
    ]
    caption = (
        "Ranges in which the squared error is largest; over the squared noise (χ²) it is 1 where only noise is left."
    )
    return Section("Where the model fails", tables=[Table(columns, caption)])


def prediction_curves(
    study: "Study", fits: Mapping[str, Fit], bands: "PredictionBands | None" = None
) -> Iterator[Curve]:
    """Curves of measured and predicted values over time, for every channel of every run, held-out and exam runs too.

    Args:
        study: the runs.
        fits: fits by the label of their curve; the first is the model as given.
        bands: prediction bands of the last fit.
    """
    last = list(fits)[-1]
    steps = [study.blocks_by_role(fit) for fit in fits.values()]
    predicted = [{(b.run, b.channel): b.predicted for blocks in step.values() for b in blocks} for step in steps]
    for role, block in ((role, block) for role, blocks in steps[0].items() for block in blocks):
        row, run = f"{block.channel} [{block.unit}]", block.run + ROLE_REMARKS[role]
        yield Curve(row, "measured", block.time, block.measured.value, run, drawn_as_points=True)
        key = block.run, block.channel
        for label, values in zip(fits, predicted, strict=True):
            half_width = bands.half_width.get(key) if bands is not None and label == last else None
            yield Curve(row, label, block.time, values[key], run, half_width=half_width)


def sample_columns(study: "Study", fit: Fit, bands: "PredictionBands | None" = None) -> Columns:
    """Table with one row per sample: run, its role, channel, time, measured and predicted value, half the band."""
    names = ("run", "role", "channel", "time", "measured", "predicted", *(["half_width"] if bands is not None else []))
    columns: dict[str, list[Any]] = {key: [] for key in names}
    for role, block in ((role, block) for role, blocks in study.blocks_by_role(fit).items() for block in blocks):
        for name, text in (("run", block.run), ("role", role), ("channel", block.channel)):
            columns[name] += [text] * len(block.time)
        columns["time"] += block.time.tolist()
        columns["measured"] += block.measured.value.tolist()
        columns["predicted"] += block.predicted.tolist()
        if bands is not None:
            columns["half_width"] += bands.half_width[block.run, block.channel].tolist()
    return columns


def missing_force_columns(curves: Sequence[ForceCurve]) -> Columns:
    """Table with one row for each point of each curve of the missing force."""
    columns: dict[str, list[Any]] = {key: [] for key in ("run", "joint", "unit", "against", "x_unit")}
    for key, values in columns.items():
        for curve in curves:
            values += [getattr(curve, key)] * len(curve.x)
    for key in ("x", "as_given", "std", "repaired"):
        rows = [getattr(curve, key) for curve in curves]
        columns[key] = [v for c, row in zip(curves, rows, strict=True) for v in (c.x * np.nan if row is None else row)]
    return columns


def step_table(
    path: Sequence[RepairStep], scale: ChannelScale, holdout_kinds: Sequence[HoldoutKind], summaries: Mapping[str, str]
) -> Table:
    """Table of how the error falls in a repair: a row for each step, a column with bars for each kind of runs.

    Args:
        path: steps of the repair; the first is the model as given.
        scale: units of the channels.
        holdout_kinds: kinds of runs that the caption explains.
        summaries: one sentence on each effect, by its name.
    """
    given = path[0]
    kinds = {kind: [step.errors.get(kind, {}) for step in path] for kind in given.errors}
    units = set(scale.units.values())
    unit = f" [{next(iter(units))}]" if len(units) == 1 else ""
    columns = [Column("step", [step_name(step) for step in path])]
    for kind, errors in kinds.items():
        texts = [error_text(rmse, scale, bare=bool(unit)) for rmse in errors]
        columns.append(
            Column(f"{kind}{unit}", texts, bar_lengths=[relative_error(rmse, errors[0], scale) for rmse in errors])
        )
    columns += [
        Column("χ² per sample", [step.chi2_per_sample for step in path]),
        Column("BIC", [step.bic for step in path], ".6g"),
        Column(
            "what it is",
            ["; ".join(summaries.get(n, "") for n in step.added) for step in path],
            dropped_when_narrow=True,
        ),
    ]
    if any(step.tied_with for step in path):
        columns.append(Column("indistinguishable from", [step.tied_with for step in path]))
    caption = "; ".join(judge.value for judge in holdout_kinds)
    if len(given.rmse) > len(units):
        caption = f"errors: root mean square, of several channels the root of their summed squares; {caption}"
    caption = f"{caption}; χ² per sample: squared error over squared noise, 1 where only noise is left"
    caption = f"{caption}; BIC: smaller is better"
    return Table(columns, f"{caption[:1].upper()}{caption[1:]}.", "steps")


def candidate_table(
    found: Sequence[Any], given: Mapping[str, float], scale: ChannelScale, summaries: Mapping[str, str]
) -> Table:
    """Table of effects that may be missing: the error that remains if one is added alone, and the evidence for it.

    Args:
        found: ranked effects, the best first; see `RankedEffect`.
        given: error of the model as given, by channel.
        scale: units of the channels.
        summaries: one sentence on each effect, by its name.
    """
    values = [
        ", ".join(f"{name.partition('.')[2]} {p.value:.4g} {p.unit}" for name, p in s.parameters.items())
        if len(s.parameters) <= MAX_LISTED_VALUES
        else f"{len(s.parameters)} values"
        for s in found
    ]
    columns = [
        Column("effect", [s.effect for s in found]),
        Column("joints", [joint_text(s.joints) for s in found]),
        Column("what it is", [summaries.get(s.effect, "") for s in found], dropped_when_narrow=True),
        Column(
            "error",
            [error_text(s.rmse, scale) for s in found],
            bar_lengths=[relative_error(s.rmse, given, scale) for s in found],
            title="error with it alone",
        ),
        Column("held out", [error_text(s.held_out_rmse, scale) if s.held_out_rmse else None for s in found]),
        Column("its values", values, dropped_when_narrow=True),
        Column("delta_bic", [s.delta_bic for s in found], ".1f", title="ΔBIC"),
        Column("p_value", [s.p_value for s in found], ".1e", title="p of chance"),
        Column("tied_with", [", ".join(s.tied_with) for s in found], title="indistinguishable from"),
    ]
    caption = (
        f"Error: root mean square over the fitted runs, {error_text(given, scale)} as given"
        + ("; of several joints the root of their summed squares. " if len(given) > 1 else ". ")
        + "ΔBIC: evidence for the effect; 10 is strong, and counts only where what is left is noise."
    )
    return Table(columns, caption, "candidates")


def error_fall_sentence(path: Sequence[RepairStep], scale: ChannelScale) -> str:
    """Sentence on the error before and after a repair, for the kind of runs that were used least for it."""
    steps = len(path) - 1
    if not steps:
        return "Nothing was added."
    *_, kind = path[0].errors
    first, last = (error_text(step.errors.get(kind, {}), scale) for step in (path[0], path[-1]))
    return f"{first} → {last} ({kind}) in {steps} step{'' if steps == 1 else 's'}."


def step_columns(path: Sequence[RepairStep], units: Mapping[str, str]) -> Columns:
    """Table with one row for each step of a repair, with the errors of every channel."""
    columns: dict[str, list[Any]] = {
        "step": [" + ".join(step.added) or "as given" for step in path],
        "joints": [", ".join(step.joints) for step in path],
    }
    for kind, errors in (("rmse", "rmse"), ("held out", "held_out_rmse")):
        for channel, unit in units.items():
            values = [getattr(step, errors).get(channel) for step in path]
            if any(value is not None for value in values):
                columns[f"{kind} {channel} [{unit}]"] = values
    return columns | {name: [getattr(step, name) for step in path] for name in ("chi2_per_sample", "bic")}


def step_name(step: RepairStep) -> str:
    """Name of a step of a repair, such as ``"+ joint_spring (elbow, wrist)"``."""
    text = " ".join(f"+ {name}" for name in step.added) or "as given"
    if step.values:
        return f"{text} ({step.values} small values)"
    return f"{text} ({joint_text(step.joints)})" if step.joints else text


def joint_text(joints: Sequence[str]) -> str:
    """Names of joints, joined by commas, if they are few; otherwise their number."""
    return ", ".join(joints) if len(joints) <= MAX_NAMED_JOINTS else f"{len(joints)} joints"


def error_text(rmse: Mapping[str, float], scale: ChannelScale, *, bare: bool = False) -> str:
    """Text such as ``"0.12 N m, 0.3 N"``: the total error of the channels of each unit (root of the summed squares).

    Args:
        rmse: root mean square error by channel.
        scale: units of the channels.
        bare: whether to leave the units out.
    """
    sums = total_errors(rmse, scale.units)
    return ", ".join(f"{v:.4g}" if bare else f"{v:.4g} {unit}" for unit, v in sums.items()) or "–"


def relative_error(rmse: Mapping[str, float], given: Mapping[str, float], scale: ChannelScale) -> float:
    """Ratio of an error to that of the model as given, both by channel.

    For several units it is the root mean square of their ratios; 0 where there are no errors.
    """
    now, before = total_errors(rmse, scale.units), total_errors(given, scale.units)
    ratios = [now[unit] / before[unit] for unit in now if before.get(unit)]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 0.0


ROLE_WORDS = {"exam": "exam", "held_out": "held-out", "training": "training"}
ROLLOUT_WORDS = {
    "closed_loop": "whole recordings in closed loop",
    "window_0.5": "pieces of 0.5 s",
    "window_5": "pieces of 5 s",
}


def drive_section(
    drives: Mapping[str, "Servo"], stated: Mapping[str, "Servo"], parameters: Mapping[str, Parameter]
) -> Section:
    """Section on the gains and delays of identified drives, by the name of the drive, beside those that were stated.

    Where no recording determines a gain, a second table has the ratios of parameters to it.
    """
    known = [(name, servo, servo.gain) for name, servo in drives.items() if servo.gain is not None]
    columns = [
        Column("drive", [name for name, _, _ in known]),
        *attribute_columns([servo for _, servo, _ in known], joints="", law=""),
        *attribute_columns([gain for _, _, gain in known], value=".5g"),
        Column("std", [gain.std for _, _, gain in known], ".2g", missing_text="given"),
        Column("unloaded", [servo.unloaded for _, servo, _ in known], ".2g", title="std if nothing unknown is carried"),
        Column("unit", [gain.unit for _, _, gain in known]),
        Column("delay", [servo.delay for _, servo, _ in known], ".3g", title="delay [s]"),
    ]
    tables = [Table(columns, name="drives")]
    ratios = [
        (name, p, gain) for _, servo, gain in known if not servo.determined
        for name, p in parameters.items() if p.joint in servo.joints and ("N" in p.unit or p.unit.startswith("kg"))
    ]  # fmt: skip
    if ratios:
        tables.append(
            Table(
                [
                    Column("ratio to k_p", [name for name, _, _ in ratios]),
                    Column("value", [p.value / gain.value for _, p, gain in ratios], ".5g"),
                    Column("std", [None if p.std is None else p.std / gain.value for _, p, gain in ratios], ".2g"),
                    Column("unit", [f"{p.unit} per {gain.unit}" for _, p, gain in ratios]),
                ],
                "No recording says how large these gains are: what is right are the ratios to them.",
                "ratios",
            )
        )
    text = (
        "Gain, and delay from a command to its torque. The gain's std includes that the arm may carry a usual load "
        "which nobody has stated. Frictions and inertias are in proportion to the gain; their std are at this gain."
    )
    for name, _, gain in known:
        before = stated[name].gain if name in stated else None
        if before is None or before.std is None:
            continue
        apart = gain.value - before.value
        if abs(apart) > SURPRISING_STDS * float(np.hypot(before.std, gain.std or 0.0)):
            text += (
                f" The gain of {name} is {gain.value / before.value:.2g} times the stated one ({before.value:.3g} +/- "
                f"{before.std:.2g} {before.unit}): its settings, such as the register P, differ from the usual ones."
            )
    return Section("Drives", text, tables=tables)


def motion_section(found: Sequence["SimulatedPositionError"]) -> Section:
    """Section on the errors of simulated motion, for the kind of runs that were used least for the fit."""
    role = next(role for role in ROLE_WORDS if any(r.role == role for r in found))
    rows: dict[tuple[str, str], list[SimulatedPositionError]] = {}
    for r in found:
        if r.role == role:
            rows.setdefault((r.joint, r.kind), []).append(r)

    def mean(errors: Sequence[tuple[float | None, float | None]]) -> tuple[float | None, float | None]:
        rms, mae = ([e for e in each if e is not None] for each in zip(*errors, strict=True))
        if len(rms) < len(errors):
            return None, None
        return float(np.sqrt(np.mean(np.square(rms)))), float(np.mean(mae))

    errors = [mean([(r.rms, r.mae) for r in of]) for of in rows.values()]
    told = [[r.position_is_command for r in of if r.position_is_command is not None] for of in rows.values()]
    aside = [mean(each)[0] if each else None for each in told]
    columns = [
        Column("joint", [joint for joint, _ in rows]),
        Column("simulated", [ROLLOUT_WORDS[kind] for _, kind in rows]),
        Column("unit", [of[0].unit for of in rows.values()]),
        Column("rms", [e[0] for e in errors]),
        Column("mean_absolute", [e[1] for e in errors]),
        Column("position_is_command", aside, title="rms if position = command"),
        Column("encoder", [of[0].resolution or None for of in rows.values()], title="encoder's step"),
    ]
    text = (
        f"The model is simulated with the recorded commands or torques of the {ROLE_WORDS[role]} runs, without their "
        "positions; the error of its positions:"
    )
    if any(rms is None for rms, _ in errors):
        text += " – stands for more than a turn; without its controller an arm drifts away after a while."
    return Section("Motion", text, tables=[Table(columns, name="motion")])


def link_section(links: Sequence["LinkInertiaChange"]) -> Section:
    """Section on the links of an arm that a repair changed: values, which of them the runs determine, warnings."""
    every = [q for link in links for q in link.quantities]
    determined = sum(q.determined for q in every)
    text = f"These runs determine {determined} of the {len(every)} values of the links below. "
    if determined < len(every):
        text += (
            "Torques tell sums over several links; a value of a single link that is not determined may be wrong "
            "although the torques are right. "
        )
    text += " ".join(f"Look out: {link.warning}." for link in links if link.warning)
    return Section("Links", text.strip(), tables=[_link_table(link) for link in links])


def _link_table(link: "LinkInertiaChange") -> Table:
    found = link.quantities
    names = [name.partition("_") for name in (q.name for q in found)]
    columns = [
        Column(link.joint, [f"{LINK_WORDS[kind]} {axis}".strip() for kind, _, axis in names]),
        Column("URDF", [q.described for q in found]),
        # Rounding leaves a tiny number where the exact value is zero.
        Column("repaired", [q.value if abs(q.value) > 1e-6 * max(q.std, abs(q.described)) else 0.0 for q in found]),
        *attribute_columns(found, std=".2g", unit=""),
        Column("determined", ["yes" if q.determined else "not by these runs" for q in found]),
    ]
    caption = (
        f"The link that {link.joint} moves, with all that is fixed to it, in the frame of that joint; inertia is about "
        "the centre of mass."
    )
    return Table(columns, caption)
