"""Whatever a joint is called, a file made of it says that name and does nothing else."""

import ast
import json
import subprocess
import tempfile
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from worlds.baxter import generate

from armdyn.arm.model import arm_model
from armdyn.codegen import find_compiler
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.studies import make_study
from armdyn.model_file import ModelFile, base_pendulum, model_text, read_model_file, write_model_file
from armdyn.quoting import c_comment, identifier, one_line, python_docstring, toml_string
from pipeline.exports.functions import c_text, exported_functions, python_text
from pipeline.exports.left_out import export_deviation
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.urdf_file import urdf_text

URDF = """<robot name="toy"><link name="base"/><link name="l"><inertial><mass value="2"/><origin xyz="0 0 0.5"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name={name} type="revolute"><parent link="base"/><child link="l"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>"""


ATTACKS = (
    '*/ int evil(void) { return 1; } /*', '"""\nimport os\n"""', '"""; import os; """', "\\", '\\"""', "a\\", "*\\/",
    "*??/", "/*", "//", "#include <evil.h>", "</script><script>evil()</script>", "<img src=x onerror=evil()>",
    "']; evil() #", '"\n[evil]\n', "${evil}", "{evil}", "%n", "é😀", "]]>", "-->", "& ", "a[b]", "x" * 200,
)  # fmt: skip


LETTERS = "".join(ATTACKS) + "\x00\x1b\x7f\r\t\u2028\u202e\ud800"


names = st.text(LETTERS, min_size=1, max_size=40) | st.sampled_from(ATTACKS)
shown = (st.sampled_from(ATTACKS) | names).filter(lambda name: name.isprintable() and name.strip() and len(name) <= 200)


def examples(test):
    for attack in ATTACKS:
        test = example(attack)(test)
    return test


def arm(name, folder):
    path = Path(folder) / "arm.urdf"
    path.write_text(URDF.format(name=quoteattr(name)), encoding="utf-8")
    return arm_model(path).with_effect(CATALOGUE["joint_stribeck_friction"])


@examples
@given(names)
def test_a_quoted_name_ends_where_it_should_in_every_language(name):
    for lines in ([name], [name, "", name], [f"{name}."]):
        (only,) = ast.parse(python_docstring(lines)).body
        assert isinstance(only.value, ast.Constant)
        assert one_line(name) in only.value.value
    text = c_comment([name, f"{name} {name}"])
    assert (text.index("*/"), text.rindex("/*")) == (len(text) - 2, 0)
    assert "??/" not in text
    if name.isprintable() or not any(0xD800 <= ord(c) < 0xE000 for c in name):  # which no file can hold
        assert tomllib.loads(f"a = {toml_string(name)}\n# {one_line(name)}\n") == {"a": name}
    assert identifier(name).isascii()
    assert identifier(name).isidentifier()


@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(shown)
def test_generated_files_of_any_joint_name_hold_it_and_nothing_else(name):
    with tempfile.TemporaryDirectory() as folder:
        model = arm(name, folder)
        functions, _ = exported_functions(model)
        python = ast.parse(python_text(functions, [f"of {name}", name]))
        assert [type(item) for item in python.body] == [ast.Expr, ast.Import, *[ast.FunctionDef] * len(functions)]
        assert name in python.body[0].value.value
        assert name in ast.get_docstring(python.body[2], clean=False)
        assert ET.fromstring(urdf_text(model, Path(folder))[0]).find("joint").get("name") == name
        text = mujoco_text(model)[0]
        assert ET.fromstring(text).find(".//joint").get("name") == name
        assert mujoco.MjModel.from_xml_string(text).joint(0).name == name
        table = tomllib.loads(model_text(ModelFile(model, {"joints": [name]}), Path(folder)))
        assert table["joints"] == [name]
        assert f"joint_stribeck_friction.torque[{name}]" in table["parameters"]


@pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler")
@pytest.mark.parametrize("name", [name for name in ATTACKS if name.isprintable()])
def test_the_c_file_compiles_for_any_joint_name_and_defines_nothing_else(name, tmp_path):
    functions, _ = exported_functions(arm(name, tmp_path))
    (tmp_path / "m.c").write_text(c_text(functions, [f"of {name}", name]), encoding="utf-8")
    subprocess.run([find_compiler(), "-std=c99", "-trigraphs", "-Wall", "-Werror", "-Wno-unused-function", "-c", "m.c"],
                   check=True, cwd=tmp_path)  # fmt: skip
    assert b"evil" not in (tmp_path / "m.o").read_bytes()


class Elements(HTMLParser):
    """Tags, names of attributes, and what scripts there are, of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes = set(), set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes.update(key for key, _ in attrs)


@pytest.mark.parametrize("name", ["</script><script>evil()</script>", "<img src=x onerror=evil()>", "' onload='evil()"])
def test_a_report_of_any_joint_name_holds_no_element_of_it(name, tmp_path, armdyn):
    rng, time = np.random.default_rng(0), np.arange(300) / 50
    write_model_file(tmp_path / "m.toml", ModelFile(arm(name, tmp_path), {"joints": [name]}))
    rows = zip(time, 0.5 * np.sin(time), 4 * np.sin(0.5 * np.sin(time)) + 0.01 * rng.normal(size=300), strict=True)
    header = f"time [s],q.{name} [rad],tau.{name} [N m]\n"
    (tmp_path / "a.csv").write_text(header + "".join(f"{t},{q},{tau}\n" for t, q, tau in rows), encoding="utf-8")
    status, _, error = armdyn("compare", "m.toml", "a.csv", "--report", "a.html")
    assert status == 0, error
    found = Elements((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert not found.tags & {"img", "iframe", "object", "embed", "link", "base"}
    assert not {attribute for attribute in found.attributes if attribute.startswith("on")}


LATE = "torque_delay"


def repaired(file, offset):
    """A model file with a delay and a spring, as a repair leaves it."""
    model = arm_model(robot="ur5").with_effect(CATALOGUE["joint_spring"]).with_effect(CATALOGUE[LATE])
    joint = f"tau.{model.joints[1]}"
    history = (
        {"added": "joint_spring", "rmse": {joint: 1.0}, "contribution": {joint: 9.0}, "as_given_rmse": {joint: 10.0}},
        {"added": LATE, "rmse": {joint: 0.1}, "contribution": {joint: offset}},
    )
    write_model_file(file, ModelFile(model, {"robot": "ur5", "joints": list(model.joints)}, history))
    return joint


@pytest.mark.parametrize(("offset", "status"), [(0.4, 0), (0.6, 1)])
def test_more_than_a_twentieth_of_what_the_repair_removed_is_not_left_out_without_asking(
    tmp_path, armdyn, offset, status
):
    exported, answer = tmp_path / "m.xml", tmp_path / "a.json"
    joint = repaired(tmp_path / "m.toml", offset)
    asked = ("export", str(tmp_path / "m.toml"), "--output", str(exported))
    assert armdyn(*asked, "--json", str(answer))[0] == status
    assert exported.exists() is (status == 0)
    said = json.loads(answer.read_text())
    assert said["error"] == {joint: offset}
    assert said["share_of_removed_error"] == pytest.approx(offset / 10.0, rel=1e-2)
    assert armdyn(*asked, "--force")[0] == status  # which writes over what is there, and no more
    again, out, _ = armdyn(*asked, "--incomplete", "--force")
    assert again == 0
    assert exported.exists()
    assert f"{offset:g} N m on {joint[4:]}" in out


def test_a_file_that_holds_everything_leaves_nothing_out(tmp_path):
    repaired(tmp_path / "m.toml", 5.0)
    file = read_model_file(tmp_path / "m.toml")
    assert export_deviation(file, {"joint_spring", LATE}) is None
    assert export_deviation(file, {LATE}).total == pytest.approx(9.0)


def test_what_an_offset_does_is_the_offset():
    model = arm_model(robot="baxter").with_effect(CATALOGUE["torque_offset"])
    fit = make_study(model, [generate("torque_offset", 1.0, 3)], [], []).first()
    for channel, value in fit.contribution(["torque_offset"]).items():
        offset = fit.values[list(fit.problem.mask_of_unknowns([f"torque_offset.torque[{channel[4:]}]"])).index(True)]
        assert value == pytest.approx(abs(offset), rel=1e-6)


def test_a_pendulums_functions_owe_nothing_to_its_sensors(tmp_path, armdyn):
    model, of_the_cell = base_pendulum().with_effect(CATALOGUE["sensor_bias"]), {"load_force": 1.0}
    entry = {"added": "sensor_bias", "rmse": {}, "contribution": of_the_cell, "as_given_rmse": of_the_cell}
    write_model_file(tmp_path / "p.toml", ModelFile(model, {}, (entry,)))
    status, out, _ = armdyn("export", "p.toml", "--output", "p.py")
    assert status == 0
    assert "sensor_bias" in out
