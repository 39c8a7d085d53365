"""The page on stages names everything that an effect can read and change, and nothing else."""

import dataclasses
import inspect
import re
from pathlib import Path

import pytest

from armdyn.arm import physics as arm
from armdyn.effects.catalogue import STAGES
from armdyn.pendulum import physics as pendulum

PAGE = (Path(__file__).parents[2] / "docs/stages.md").read_text()
CLASSES = {
    "gripper": pendulum.Gripper, "string": pendulum.String, "load": pendulum.Load, "tension": pendulum.Tension,
    "sensor": pendulum.Sensor, "joint": arm.Joint, "link": arm.Link, "neighbour": arm.Neighbour, "base": arm.Base,
}  # fmt: skip


@pytest.mark.parametrize("stage", CLASSES)
def test_a_section_names_what_a_stage_offers(stage):
    section = re.search(rf"\n## {stage}\n(.*?)(?=\n## |\Z)", PAGE, re.DOTALL)[1]
    kind = CLASSES[stage]
    fields = {field.name for field in dataclasses.fields(kind)} - {"memory"}
    fields |= {name for name, _ in inspect.getmembers(kind, lambda member: isinstance(member, property))}
    changes = {
        f"{name}({', '.join([*inspect.signature(function).parameters][1:])})"
        for name, function in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_") and name != "with_state"
    }
    assert set(re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)) == fields | changes


def test_every_stage_of_the_catalogue_has_a_section():
    assert set(STAGES) <= CLASSES.keys()


def test_the_effect_that_is_shown_is_one():
    names = {}
    exec(re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1], names)
    assert names["my_linear_drag"].acts_on == "load"
