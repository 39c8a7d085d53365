"""`armdyn inspect` and the commands that ask first."""

import json

import pytest
from robots import joint, link, robot
from worlds import mistakes, sound_recordings

from armdyn.run import read_run, write_run_csv

JOINTS = [f"panda_joint{i}" for i in range(1, 8)]


@pytest.fixture
def files(armdyn, tmp_path):
    """A model, a sound recording and one whose torques are in mN m."""
    assert armdyn("new", "arm", "m.toml", "--robot", "panda")[0] == 0
    sound = sound_recordings.arm("panda", "as described", 0, duration=6.0).run
    write_run_csv(sound, tmp_path / "sound.csv")
    write_run_csv(mistakes.scaled(sound, [f"tau.{j}" for j in JOINTS], 1e3), tmp_path / "wrong.csv")
    return tmp_path


def test_fix_writes_a_copy_and_a_map_that_does_the_same_at_import(armdyn, refused, files):
    assert armdyn("inspect", "m.toml", "wrong.csv", "--fix", "fixed", "--report", "r.html")[0] == 1
    assert armdyn("inspect", "m.toml", "fixed/wrong.csv")[0] == 0
    assert armdyn("import", "wrong.csv", "--output", "again", "--map", "fixed/wrong.map.toml")[0] == 0
    sound = read_run(files / "sound.csv")
    for folder in ("fixed", "again"):
        mended = read_run(files / folder / "wrong.csv")
        for name, channel in sound.channels.items():
            assert mended.channels[name].value == pytest.approx(channel.value, rel=1e-9, abs=1e-12)
    assert "torque_unit" in (files / "r.html").read_text()
    assert "--force" in refused("inspect", "m.toml", "wrong.csv", "--fix", "fixed")


@pytest.mark.parametrize("command", [("compare",), ("diagnose",), ("repair", "--output", "out.toml")])
def test_other_commands_name_no_effect_for_a_wrong_recording_unless_it_is_trusted(armdyn, files, command):
    name, *options = command
    status, said, _ = armdyn(name, "m.toml", "wrong.csv", *options)
    assert status == 1
    assert "mN m" in said.splitlines()[0]
    assert "payload" not in said
    assert not (files / "out.toml").exists()
    if name == "compare":
        status, said, _ = armdyn("compare", "m.toml", "wrong.csv", "--trust-data", "--json", "-")
        assert status == 0
        assert [check["kind"] for check in json.loads(said)["recording_checks"]] == ["torque_unit"]


def test_a_link_that_weighs_nothing_is_said(armdyn, tmp_path):
    joints = (joint("first", "base", "a"), joint("second", "a", "b"))
    (tmp_path / "arm.urdf").write_text(robot('<link name="base"/>', link("a"), '<link name="b"/>', *joints))
    status, said, _ = armdyn("new", "arm", "m.toml", "--urdf", "arm.urdf")
    assert status == 0
    assert "CHECK: link 'b' has no <inertial>" in said
    assert "link 'a'" not in said
