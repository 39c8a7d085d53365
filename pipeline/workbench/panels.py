"""The page's panels as HTML, made from the state; every text is escaped."""

from collections.abc import Collection, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from armdyn.identify.sentence import total_errors
from armdyn.inspection.check import Inspection
from pipeline.exports import formats
from pipeline.report.inspection import checks_section
from pipeline.report.overlay import FITTED, HELD_OUT, quality
from pipeline.report.page import bar, key_html, table_html
from pipeline.report.theme import full_name, number
from pipeline.workbench.bench import Knob, TickedModel, Workbench

HOW = {
    "predicted": "predicted from one linearisation; the refit is running",
    "fitted": "fitted to all samples",
    "by hand": "parameters by hand, nothing fitted",
}
MAX_LISTED_JOINTS = 2
MAX_NAMED_PLACES = 2
"""Places where a model fails that are named; the curves show the others."""


def effects_panel(bench: Workbench, ticked: Collection[str]) -> str:
    """Panel of effects: a line per effect with a box per joint; effects of the given model cannot be unticked."""
    every = [*bench.present.values(), *bench.candidates.values()]
    short = short_joints([joint for one in every for joint in one.joints])
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


def short_joints(joints: Sequence[str]) -> dict[str, str]:
    """Short names without the common beginning or ending of all names: ``s0`` for ``right_s0``."""
    words = {name: name.split("_") for name in joints}
    for side in (0, -1):
        while (
            len(words) > 1 and all(len(w) > 1 for w in words.values()) and len({w[side] for w in words.values()}) == 1
        ):
            words = {name: w[1:] if side == 0 else w[:-1] for name, w in words.items()}
    return {name: "_".join(w) for name, w in words.items()}


def errors_panel(state: TickedModel) -> str:
    """Panel of errors before and after on every kind of run, in the channels' unit."""
    units = {curve.channel: curve.unit for curve in state.curves}
    figures = []
    for kind in (FITTED, HELD_OUT):
        mine = [curve for curve in state.curves if curve.kind == kind]
        if not mine or (kind == HELD_OUT and state.stale):
            continue
        for unit in dict.fromkeys(units.values()):
            before, after = (quality([c for c in mine if c.unit == unit], step).rmse for step in (0, 1))
            note = f"as given {number(before, unit)}"
            if before and after != before:
                note += f", {100.0 * (after / before - 1.0):+.0f} %".replace("-", "−")
            value = f" data-value='{after!r}'"
            figures.append(key_html(f"Error, {kind} runs", number(after, unit), note, value))
    if state.others and not any(curve.kind == HELD_OUT for curve in state.curves):
        for unit, error in total_errors(state.others, units).items():
            text, value = "Error, runs predicted from the others", f" data-value='{error!r}'"
            figures.append(key_html(text, number(error, unit), "", value))
    how = f"<p class='how {state.how.replace(' ', '-')}'>{HOW[state.how]}</p>"
    return f"<div class='keys'>{''.join(figures)}</div>{how}{_where(state, units)}"


def _where(state: TickedModel, units: Mapping[str, str]) -> str:
    worst: dict[tuple[str, str], str] = {}
    for place in state.places:
        name = full_name(place.channel, units[place.channel])
        within = f" in {place.run}" if place.run else ""
        span = f"from {place.start:.3g} to {place.end:.3g} {place.unit}{within}"
        worst.setdefault((place.channel, place.against), f"{name} against {place.against}, {span}")
    if not worst:
        return ""
    return f"<p class='caption'>Fails most: {escape('; '.join(list(worst.values())[:MAX_NAMED_PLACES]))}.</p>"


def knobs_panel(state: TickedModel) -> str:
    """Panel with a slider for every parameter of the model."""
    none = "<p class='caption'>The model has no parameters yet: tick an effect.</p>"
    return "".join(_slider(name, knob) for name, knob in state.knobs.items()) or none


def _slider(name: str, knob: Knob) -> str:
    value, unit = knob.parameter.value, knob.parameter.unit
    spread = f" ± {knob.parameter.std:.2g}" if knob.parameter.std is not None else ""
    return (
        f"<label class='knob'><span>{escape(name)}</span>"
        f"<input type='range' data-knob='{escape(name)}' step='any' "
        f"min='{knob.low!r}' max='{knob.high!r}' value='{value!r}'>"
        f"<output data-unit='{escape(unit)}'>{value:.4g}{spread} {escape(unit)}</output></label>"
    )


def ranking_panel(answer: Mapping[str, Any]) -> str:
    """Panel of candidates, best first, each with its error, its ties and a button that ticks it.

    Args:
        answer: JSON of `diagnose`, and ``beside``, labels of the effects that the model had besides.
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
        tie = f"<br><span class='tie'>these runs cannot tell it from {escape(ties)}</span>" if ties else ""
        left = ", ".join(number(error, unit) for unit, error in after.items())
        rows.append(
            f"<tr><td><b>{escape(effect)}</b>{escape(places)}{tie}</td>{bar(left, share, judged=False)}"
            f"<td><button type='button' data-try='{escape(label)}'>try</button></td></tr>"
        )
    remedies = f"<p class='caption'>What would tell them apart: {escape('; '.join(answer['remedies']))}.</p>"
    head = "<tr><th>alone beside the model</th><th>remaining error</th><th></th></tr>"
    table = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
    return f"{said}<div class='table'>{table}</div>{remedies if answer['remedies'] else ''}"


def files_panel(model: Path | None, runs: Sequence[tuple[Path, bool]], said: Sequence[str]) -> str:
    """Panel of the page's files; a recording can be fitted, held out, or left out.

    Args:
        model: file of the model; None where there is none yet.
        runs: recordings, each with whether it is held out.
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
    """Panel of the inspection's findings, the worst first."""
    tables = checks_section(found.checks).tables
    return f"<p class='sentence'>{escape(found.sentence)}</p>{''.join(map(table_html, tables))}"


def kinds_of_export() -> str:
    """Options of formats in which a model can be exported."""
    options = "".join(
        f"<option value='{ending}'>{escape(made.kind)} ({ending})</option>" for ending, made in formats().items()
    )
    return f"<option value=''>nothing else</option>{options}"
