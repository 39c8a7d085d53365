"""The documentation is a site that builds without a warning: every link, every anchor, every name of the reference."""

import dataclasses
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from armdyn.arm import physics as arm
from armdyn.effects.catalogue import STAGES
from armdyn.pendulum import physics as pendulum

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for module in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(module, reason="the site needs mkdocs: pip install 'armdyn[docs]'")
    target = tmp_path_factory.mktemp("site")
    command = ["build", "--strict", "--quiet", "--config-file", ROOT / "docs/site/mkdocs.yml", "--site-dir", target]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run([sys.executable, "-m", "mkdocs", *command], capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stderr[-3000:]
    return target


def test_the_reference_shows_the_front_door(site):
    page = (site / "reference/index.html").read_text()
    for name in ("armdyn.front.repair", "armdyn.run.Run.from_arrays", "armdyn.displayable.Displayable.to_dataframe"):
        assert f'id="{name}"' in page
    assert "recordings that help to choose effects, but are never fitted" in page


def test_every_page_of_the_documentation_is_in_it(site):
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert pages <= {path.parent.name for path in site.rglob("index.html")}


def test_nothing_is_loaded_from_elsewhere(site):
    assert "fonts.googleapis" not in (site / "index.html").read_text()


PAGE = (Path(__file__).parents[2] / "docs/stages.md").read_text()
CLASSES = {
    "gripper": pendulum.Gripper, "string": pendulum.String, "load": pendulum.Load, "tension": pendulum.Tension,
    "sensor": pendulum.Sensor, "joint": arm.Joint, "link": arm.Link, "neighbour": arm.Neighbour, "base": arm.Base,
    "told": arm.DriveCommands, "wrench": arm.Wrench,
}  # fmt: skip


@pytest.mark.parametrize("stage", CLASSES)
def test_a_section_names_what_a_stage_offers(stage):
    section = re.search(rf"\n## {stage}\n(.*?)(?=\n## |\Z)", PAGE, re.DOTALL)[1]
    kind = CLASSES[stage]
    fields = {field.name for field in dataclasses.fields(kind)} - {"added_states"}
    fields |= {name for name, _ in inspect.getmembers(kind, lambda member: isinstance(member, property))}
    changes = {
        f"{name}({', '.join([*inspect.signature(function).parameters][1:])})"
        for name, function in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_") and name != "with_state"
    }
    assert set(re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)) == fields | changes


def test_every_stage_of_the_catalogue_has_a_section():
    assert set(STAGES) - {"drive"} <= CLASSES.keys()  # what acts on a drive is given its joint


def test_the_effect_that_is_shown_is_one():
    names = {}
    exec(re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1], names)
    assert names["my_linear_drag"].acts_on == "load"
