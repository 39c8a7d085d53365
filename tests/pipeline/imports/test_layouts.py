"""Foreign layouts: every column becomes the right channel in the right unit, or a person is asked; none is lost.

`GOLDEN=write pytest tests/pipeline/imports` keeps what is now guessed of each; read the difference before you keep it.
"""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from armdyn.errors import InputError
from armdyn.recording.units import si_factor
from pipeline.imports import read_foreign
from pipeline.imports.guess import guess_map
from pipeline.imports.mapping import reason_comment

from .layouts import LAYOUTS

KEPT = Path(__file__).with_name("layouts.json")


def guessed(layout, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(layout.text(), encoding="utf-8")
    return guess_map(read_foreign(path), layout.joints)


def silently_wrong(layout, found):
    """Sentences on what is not what it was made as, or lost, and asks for nobody."""
    truth = {made.header.split(" [")[0].split("(")[0].strip(): made for made in layout.made()}
    wrong = []
    for name, entry in found.entries.items():
        made = truth.get(name)
        kind = "current" if entry.torque_constant else entry.channel.partition(".")[0]
        right = made is not None and made.channel == entry.channel and made.unit != "counts"
        if right:
            scale = si_factor(entry.unit, "A") / si_factor(made.unit, "A") if kind == "current" else scaled(entry, made)
            right = abs(scale - 1.0) < 1e-9
        if not (right or entry.check):
            wrong.append(f"{name} -> {entry.channel} [{entry.unit}] {reason_comment(entry.why, entry.check)}")
    asked = {entry.channel for entry in found.entries.values() if entry.check}
    for name, made in truth.items():
        if made.channel and name not in found.entries and made.channel not in asked:
            wrong.append(f"{name} is lost")
    if (
        found.time != layout.time.split(" (")[0].split("(")[0].split(" [")[0].lstrip("%")
        or found.time_unit != layout.unit
    ) and not found.check:
        wrong.append(f"time: {found.time} {found.time_unit} {found.why}")
    return wrong


def scaled(entry, made):
    """Size of the unit that was taken over that which is right; 0 where they are of different kinds."""
    try:
        return si_factor(entry.unit, made.unit) if made.unit else 1.0
    except InputError:
        return 0.0


def told(found):
    """A guess as it is kept: by quantity, unit and reason the columns and their joints; numbers are left out."""
    lines = {f"time [{found.time_unit}] {reason_comment(found.why, found.check)}": [found.time]} if found.time else {}
    for column, entry in found.entries.items():
        quantity, _, joint = entry.channel.partition(".")
        kind = f"{quantity} [{entry.unit}] {entry.torque_constant} {reason_comment(entry.why, entry.check)}"
        lines.setdefault(kind, []).append(f"{column} = {joint}" if joint else column)
    return {re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", "#", kind): ", ".join(columns) for kind, columns in lines.items()}


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_a_layout_is_understood_or_somebody_is_asked(layout, tmp_path):
    found = guessed(layout, tmp_path)
    assert not silently_wrong(layout, found)
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    if os.environ.get("GOLDEN") == "write":
        kept = {each.name: kept.get(each.name, {}) for each in LAYOUTS} | {layout.name: told(found)}
        KEPT.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    assert told(found) == kept[layout.name]


WRITTEN = {
    "dots": lambda header: header.replace("_", "."),
    "capitals in between": lambda header: "".join(word[:1].upper() + word[1:] for word in header.split("_")),
    "a namespace": lambda header: f"robot1/{header}",
}


@pytest.mark.parametrize("way", WRITTEN)
def test_another_way_of_writing_is_never_silently_wrong(way, tmp_path):
    """It may be left out, which is listed, or refused; it is not taken for something else."""
    for layout in LAYOUTS:
        made = [replace(column, header=WRITTEN[way](column.header)) for column in layout.made()]
        if not layout.joints.arm and any(column.channel.startswith("q.") for column in made):
            continue  # without a robot a joint is called what its header calls it
        written = replace(layout, columns=lambda _, made=made: made, texts={})
        try:
            wrong = silently_wrong(written, guessed(written, tmp_path))
        except InputError:
            continue
        assert not [sentence for sentence in wrong if not sentence.endswith("is lost")], layout.name
