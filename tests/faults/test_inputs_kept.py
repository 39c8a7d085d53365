"""No command writes over what it has read, however it came to read it, and under whatever name."""

import os
import shutil
from pathlib import Path

import pytest
from robots import joint, link, robot

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.read_files import protect_inputs, register_input

PENDULUM = Path(__file__).parents[2] / "examples" / "pendulum"
COMPARE = ("compare", "m.toml", "a.csv")
ARM = ("new", "arm", "m.toml", "--urdf", "a.urdf")
MESH = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
)


@pytest.fixture
def folder(armdyn, tmp_path):
    """A pendulum's model and recording, an arm with a mesh, links to some of them."""
    for ending in ("csv", "toml"):
        shutil.copy(PENDULUM / f"swing_1.{ending}", tmp_path / f"a.{ending}")
    shape = '<visual><geometry><mesh filename="arm.stl"/></geometry></visual>'
    (tmp_path / "arm.stl").write_text(MESH)
    (tmp_path / "a.urdf").write_text(robot('<link name="base"/>', link("arm", shape=shape), joint("j", "base", "arm")))
    assert armdyn("new", "pendulum", "m.toml")[0] == 0
    (tmp_path / "link.json").symlink_to("a.toml")
    os.link(tmp_path / "a.toml", tmp_path / "hard.json")
    (tmp_path / "spec.toml").write_text('[[recordings]]\nmodel = "m.toml"\nruns = ["a.csv"]\n')
    return tmp_path


@pytest.mark.parametrize(
    ("command", "kept"),
    [
        ((*COMPARE, "--json", "a.toml"), "a.toml"),
        ((*COMPARE, "--json", "link.json"), "a.toml"),
        ((*COMPARE, "--json", "hard.json"), "a.toml"),
        ((*COMPARE, "--report", "a.toml"), "a.toml"),
        (("repair", "m.toml", "a.csv", "--output", "a.toml"), "a.toml"),
        (("inspect", "a.csv", "--json", "a.toml"), "a.toml"),
        (("new", "arm", "a.urdf", "--urdf", "a.urdf"), "a.urdf"),
        ((*ARM, "--json", "a.urdf"), "a.urdf"),
        ((*ARM, "--json", "arm.stl"), "arm.stl"),
        (("batch", "spec.toml", "--output", "out", "--json", "m.toml"), "m.toml"),
        (("batch", "spec.toml", "--output", "out", "--json", "a.toml"), "a.toml"),
    ],
)
def test_what_was_read_indirectly_is_kept(folder, refused, command, kept, complains):
    before = (folder / kept).read_bytes()
    complains.line(refused(*command))
    assert (folder / kept).read_bytes() == before


def test_a_trials_folder_does_not_hold_what_the_trial_has_read(folder, refused, complains):
    shutil.copy(folder / "m.toml", folder / "model.toml")
    before = (folder / "model.toml").read_bytes()
    complains.line(refused("trial", "--model", "model.toml", "--out", ".", "--seed", "1"))
    assert (folder / "model.toml").read_bytes() == before


def test_a_command_may_write_twice_and_a_repair_into_its_own_model(folder, armdyn):
    assert armdyn("add", "m.toml", "linear_drag", "a.csv")[0] == 0
    assert "linear_drag" in (folder / "m.toml").read_text()
    with protect_inputs():
        for text in ("one", "two"):
            atomic.write_text(folder / "new.txt", text)
            assert (folder / "new.txt").read_text() == text


def test_what_other_languages_read_counts_and_a_program_of_ones_own_is_free(tmp_path, complains):
    file = tmp_path / "a.bin"
    file.write_text("old")
    with protect_inputs():
        register_input(file)
        with complains(InputError):
            atomic.write_text(file, "new")
    assert file.read_text() == "old"
    atomic.write_text(file, "new")
