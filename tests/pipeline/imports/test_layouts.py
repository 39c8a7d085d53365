"""Foreign layouts: every column becomes the right channel in the right unit, or a person is asked; none is lost."""

from collections import Counter
from dataclasses import replace

import pytest

from armdyn.errors import InputError
from armdyn.units import si_factor
from pipeline.imports import read_foreign
from pipeline.imports.guess import guess_map

from .layouts import LAYOUTS

ALL_RIGHT = 38
"""Layouts that needed nobody when this was written; a change that asks more often must say why."""


def judged(layout, tmp_path):
    """Sentences on what is silently wrong or lost, and how many lines ask for a person."""
    path = tmp_path / "log.csv"
    path.write_text(layout.text(), encoding="utf-8")
    found = guess_map(read_foreign(path), layout.joints)
    truth = {made.header.split(" [")[0].split("(")[0].strip(): made for made in layout.made()}
    wrong = []
    for name, entry in found.entries.items():
        made, asks = truth.get(name), "CHECK" in entry.why
        kind = "current" if entry.torque_constant else entry.channel.partition(".")[0]
        right = made is not None and made.channel == entry.channel and made.unit != "counts"
        if right:
            scale = si_factor(entry.unit, "A") / si_factor(made.unit, "A") if kind == "current" else scaled(entry, made)
            right = abs(scale - 1.0) < 1e-9
        if not (right or asks):
            wrong.append(f"{name} -> {entry.channel} [{entry.unit}] {entry.why}")
    asked = {entry.channel for entry in found.entries.values() if "CHECK" in entry.why}
    for name, made in truth.items():
        if made.channel and name not in found.entries and made.channel not in asked:
            wrong.append(f"{name} is lost")
    if (
        found.time != layout.time.split(" (")[0].split("(")[0].split(" [")[0] or found.time_unit != layout.unit
    ) and "CHECK" not in found.why:
        wrong.append(f"time: {found.time} {found.time_unit} {found.why}")
    return wrong, len(asked) + ("CHECK" in found.why)


def scaled(entry, made):
    """Size of the unit that was taken over that which is right; 0 where they are of different kinds."""
    try:
        return si_factor(entry.unit, made.unit) if made.unit else 1.0
    except InputError:
        return 0.0


def test_there_are_sixty_and_more():
    assert len(LAYOUTS) >= 60
    assert max(Counter(layout.name for layout in LAYOUTS).values()) == 1


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_a_layout_is_understood_or_somebody_is_asked(layout, tmp_path):
    wrong, _ = judged(layout, tmp_path)
    assert not wrong


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
            wrong, _ = judged(written, tmp_path)
        except InputError:
            continue
        assert not [sentence for sentence in wrong if not sentence.endswith("is lost")], layout.name


def test_most_layouts_need_nobody(tmp_path):
    sure = [layout.name for layout in LAYOUTS if judged(layout, tmp_path)[1] == 0]
    assert len(sure) >= ALL_RIGHT
