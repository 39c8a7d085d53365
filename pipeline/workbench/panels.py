"""HTML of the panels of the workbench's page; every text is escaped."""

from collections.abc import Collection, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from armdyn.identify.sentence import plain_number, total_errors
from armdyn.inspection.check import Inspection
from armdyn.recording.channel_names import channel_full_name
from pipeline.exports import formats
from pipeline.report.inspection import checks_section
from pipeline.report.overlay import FITTED_RUN, HELD_OUT_RUN, prediction_quality
from pipeline.report.page import bar_cell_html, key_figure_html, table_html
from pipeline.workbench.bench import ParameterSlider, SelectedEffectsModel, Workbench

PARAMETER_SOURCE_SENTENCES = {
    "predicted": "predicted from one linearisation; the refit is running",
    "fitted": "fitted to all samples",
    "by hand": "parameters by hand, nothing fitted",
}
"""Sentence on the source of the shown parameters, by `SelectedEffectsModel.how`."""
MAX_LISTED_JOINTS = 2
"""Number of joints up to which an effect's joints are listed by name."""
MAX_NAMED_FAILING_INTERVALS = 2
"""Largest number of intervals in which the model fails that are named."""


def effects_panel(bench: Workbench, ticked: Collection[str]) -> str:
    """HTML panel of effects: one line per effect, with a check box per joint.

    Args:
        bench: workbench; effects of its given model cannot be removed.
        ticked: labels of the ticked effects.
    """
    every = [*bench.present.values(), *bench.candidates.values()]
    short = short_joint_names([joint for one in every for joint in one.joints])
    rows = []
    for effect in dict.fromkeys(one.effect for one in every):
        boxes, free = "", 0
        for one in (one for one in every if one.effect == effect):
            fixed = one.label in bench.present
            free += not fixed
            text = ", ".join(short[joint] for joint in one.joints) or ("in the model" if fixed else "add")
            title = f"{one.label}: the model has it" if fixed else one.label
            state = " checked" * (fixed or one.label in ticked) + " disabled" * fixed
            boxes += (
                f"<label title='{escape(title)}'><input type='checkbox' data-pick='{escape(one.label)}'{state}>"
                f"<span>{escape(text)}</span></label>"
            )
        if free > MAX_LISTED_JOINTS:
            boxes += f"<button type='button' data-every='{escape(effect)}'>all</button>"
        summary = bench.study.effects[effect].summary
        rows.append(
            f"<div class='effect'><p><b>{escape(effect)}</b> <span>{escape(summary)}</span></p>"
            f"<div class='picks'>{boxes}</div></div>"
        )
    return "".join(rows)


def short_joint_names(joints: Sequence[str]) -> dict[str, str]:
    """Short names of joints, without a beginning or ending that all names share: ``s0`` for ``right_s0``."""
    words = {name: name.split("_") for name in joints}
    for side in (0, -1):
        while (
            len(words) > 1 and all(len(w) > 1 for w in words.values()) and len({w[side] for w in words.values()}) == 1
        ):
            words = {name: w[1:] if side == 0 else w[:-1] for name, w in words.items()}
    return {name: "_".join(w) for name, w in words.items()}


def errors_panel(state: SelectedEffectsModel) -> str:
    """HTML panel of the errors of the given and the changed model, on fitted runs and on other runs."""
    units = {curve.channel: curve.unit for curve in state.curves}
    figures = []
    for kind in (FITTED_RUN, HELD_OUT_RUN):
        mine = [curve for curve in state.curves if curve.kind == kind]
        if not mine or (kind == HELD_OUT_RUN and state.stale):
            continue
        for unit in dict.fromkeys(units.values()):
            before, after = (prediction_quality([c for c in mine if c.unit == unit], step).rmse for step in (0, 1))
            note = f"as given {plain_number(before)} {unit}"
            if before and after != before:
                note += f", {100.0 * (after / before - 1.0):+.0f} %".replace("-", "−")
            value = f" data-value='{after!r}'"
            figures.append(key_figure_html(f"Error, {kind} runs", f"{plain_number(after)} {unit}", note, value))
    if state.others and not any(curve.kind == HELD_OUT_RUN for curve in state.curves):
        for unit, error in total_errors(state.others, units).items():
            text, value = "Error, runs predicted from the others", f" data-value='{error!r}'"
            figures.append(key_figure_html(text, f"{plain_number(error)} {unit}", "", value))
    how = f"<p class='how {state.how.replace(' ', '-')}'>{PARAMETER_SOURCE_SENTENCES[state.how]}</p>"
    return f"<div class='keys'>{''.join(figures)}</div>{how}{_where(state, units)}"


def _where(state: SelectedEffectsModel, units: Mapping[str, str]) -> str:
    worst: dict[tuple[str, str], str] = {}
    for place in state.places:
        name = channel_full_name(place.channel, units[place.channel])
        within = f" in {place.run}" if place.run else ""
        span = f"from {place.start:.3g} to {place.end:.3g} {place.unit}{within}"
        worst.setdefault((place.channel, place.against), f"{name} against {place.quantity}, {span}")
    if not worst:
        return ""
    return (
        f"<p class='caption'>Fails most: {escape('; '.join(list(worst.values())[:MAX_NAMED_FAILING_INTERVALS]))}.</p>"
    )


def sliders_panel(state: SelectedEffectsModel) -> str:
    """HTML panel with a slider for every parameter of the model."""
    none = "<p class='caption'>The model has no parameters yet: tick an effect.</p>"
    return "".join(_slider(name, knob) for name, knob in state.knobs.items()) or none


def _slider(name: str, knob: ParameterSlider) -> str:
    value, unit = knob.parameter.value, knob.parameter.unit
    spread = f" ± {knob.parameter.std:.2g}" if knob.parameter.std is not None else ""
    return (
        f"<label class='knob'><span>{escape(name)}</span>"
        f"<input type='range' data-knob='{escape(name)}' step='any' "
        f"min='{knob.low!r}' max='{knob.high!r}' value='{value!r}'>"
        f"<output data-unit='{escape(unit)}'>{value:.4g}{spread} {escape(unit)}</output></label>"
    )


def ranking_panel(answer: Mapping[str, Any]) -> str:
    """HTML panel of candidate effects, the best first, each with its remaining error and a button that adds it.

    Args:
        answer: JSON of `run_diagnosis`.
    """
    beside = f" Beside {', '.join(answer['beside'])}." if answer["beside"] else ""
    said = f"<p class='sentence'>{escape(answer['sentence'] + beside)}</p>"
    if not answer["candidates"]:
        return said
    units = {name: channel["unit"] for name, channel in answer["channels"].items()}
    before = total_errors({name: channel["rmse"] for name, channel in answer["channels"].items()}, units)
    rows = []
    for found in answer["candidates"]:
        effect, joints, ties = found["effect"], found["joints"], ", ".join(found["tied_with"])
        after = total_errors(found["rmse"], units)
        share = max((after[unit] / before[unit] for unit in after if before.get(unit)), default=0.0)
        listed = ", ".join(joints) if len(joints) <= MAX_LISTED_JOINTS else f"{len(joints)} joints"
        places = f" on {listed}" if joints else ""
        label = f"{effect}:{','.join(joints)}" if joints else effect
        tie = f"<br><span class='tie'>these runs cannot distinguish it from {escape(ties)}</span>" if ties else ""
        left = ", ".join(f"{plain_number(error)} {unit}" for unit, error in after.items())
        rows.append(
            f"<tr><td><b>{escape(effect)}</b>{escape(places)}{tie}</td>{bar_cell_html(left, share, judged=False)}"
            f"<td><button type='button' data-try='{escape(label)}'>try</button></td></tr>"
        )
    remedies = f"<p class='caption'>What would distinguish them: {escape('; '.join(answer['remedies']))}.</p>"
    head = "<tr><th>added alone</th><th>remaining error</th><th></th></tr>"
    table = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
    return f"{said}<div class='table'>{table}</div>{remedies if answer['remedies'] else ''}"


def files_panel(model: Path | None, runs: Sequence[tuple[Path, bool]], said: Sequence[str]) -> str:
    """HTML panel of the opened files, in which the user chooses to fit, hold out or leave out each recording.

    Args:
        model: file of the model; None for no model yet.
        runs: file of each recording, and whether it is held out.
        said: sentences on dropped files.
    """
    rows = [f"<tr><td>model</td><td>{escape(model.name) if model else 'none yet'}</td><td></td></tr>"]
    for i, (path, held_out) in enumerate(runs):
        choice = "".join(
            f"<button type='button' data-role='{role}' data-run='{i}'{' class=chosen' * chosen}>{role}</button>"
            for role, chosen in (("fit", not held_out), ("hold out", held_out), ("leave out", False))
        )
        rows.append(f"<tr><td>run</td><td>{escape(path.name)}</td><td class='roles'>{choice}</td></tr>")
    notes = "".join(f"<p class='caption'>{escape(text)}</p>" for text in said)
    return f"<div class='table'><table><tbody>{''.join(rows)}</tbody></table></div>{notes}"


def checks_panel(found: Inspection) -> str:
    """HTML panel with the findings of an inspection of the recordings."""
    tables = checks_section(found.checks).tables
    return f"<p class='sentence'>{escape(found.sentence)}</p>{''.join(map(table_html, tables))}"


def export_options_html() -> str:
    """HTML options of the formats in which a model can be exported."""
    options = "".join(
        f"<option value='{ending}'>{escape(made.kind)} ({ending})</option>" for ending, made in formats().items()
    )
    return f"<option value=''>nothing else</option>{options}"
