"""Bad input to the commands: one line, exit status 2, nothing written."""

import json
import tomllib

import numpy as np
import pytest

GOOD = "time [s],gripper_x [m],load_force [N]\n" + "".join(
    f"{0.01 * i:.2f},{0.05 * np.sin(0.03 * i):.6f},"
    f"{0.8 + 0.01 * np.sin(0.05 * i) + 0.001 * ((i * 7919) % 13 - 6):.6f}\n"
    for i in range(300)
)
LINES = GOOD.splitlines(keepends=True)


def changed(old, new, count=1):
    return GOOD.replace(old, new, count)


BROKEN = """
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

@effect("slip", acts_on="load", summary="s", source="s")
def slip(load, coefficient=quantity("N", typical=1e-3)):
    return load.with_force(coefficient * load.sped)
"""


@pytest.fixture
def place(tmp_path):
    (tmp_path / "m.toml").write_text('base = "pendulum"\neffects = []\n')
    (tmp_path / "good.csv").write_text(GOOD)
    (tmp_path / "copy.csv").write_text(GOOD)
    (tmp_path / "broken.py").write_text(BROKEN)
    return tmp_path


@pytest.fixture
def nothing_written(refused, place):
    """The one line of bad input to a command that leaves the folder as it was."""

    def said(*arguments):
        before = sorted(p.name for p in place.iterdir())
        line = refused(*arguments)
        assert sorted(p.name for p in place.iterdir()) == before
        return line

    return said


@pytest.mark.parametrize(
    "text",
    [
        changed("load_force [N]", "gripper_v [m/s]"),
        LINES[0] + "".join(line.rsplit(",", 1)[0] + ",0.8\n" for line in LINES[1:]),
    ],
)
def test_a_bad_recording_is_refused(nothing_written, place, text, complains):
    (place / "bad.csv").write_text(text)
    complains.line(nothing_written("repair", "m.toml", "bad.csv", "--output", "n.toml", "--json", "-"))


@pytest.mark.parametrize(
    "model",
    [
        'base = "pendulum"\neffects = ["quadratic_dragg"]\n',
        'base = "pendulum"\n[parameters]\nlenght = { value = 1.0 }\n',
        'base = "pendulm"\n',
        "base = \n",
        'base = "pendulum"\n[parameters]\nlength = { value = -1.0 }\n',
        'base = "pendulum"\n[parameters]\nlength = { value = 1.0, std = nan }\n',
        'base = "pendulum"\n[parameters]\nlength = { value = 1.0, prior = "9.0 +/- 0.1" }\n',
        "effects = []\n",
    ],
)
def test_a_bad_model_file_is_refused(nothing_written, place, model, complains):
    (place / "m.toml").write_text(model)
    complains.line(nothing_written("compare", "m.toml", "good.csv"))


@pytest.mark.parametrize(
    "arguments",
    [
        ("diagnose", "m.toml", "good.csv", "--held-out", "good.csv"), ("diagnose", "m.toml", "."),
        ("diagnose", "m.toml", "absent.csv"), ("repair", "m.toml", "good.csv", "--output", "nowhere/n.toml"),
        ("repair", "m.toml", "good.csv", "--output", "good.csv"),
        ("compare", "m.toml", "good.csv", "--report", "m.toml"),
        ("compare", "m.toml", "good.csv", "--report", "r", "--json", "r"),
        ("compare", "m.toml", "good.csv", "copy.csv"), ("compare", "m.toml", "good.csv", "--held-out", "copy.csv"),
        ("repair", "m.toml", "good.csv", "--exam", "copy.csv"),
        ("diagnose", "m.toml", "good.csv", "--exam", "good.csv"),
        ("add", "m.toml", "slip", "good.csv", "--effects", "broken.py"), ("trial", "--out", "good.csv"),
        ("trial", "--json", "nowhere/x.json"), ("new", "pendulum", "good.csv"),
        ("new", "pendulum", "n.toml", "--set", "mass=80"), ("new", "pendulum", "n.toml", "--set", "masss=80 g"),
        ("new", "arm", "n.toml", "--robot", "baxter", "--joints", "right_s7"), ("effects", "--effects", "absent.py"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(nothing_written, arguments, complains):
    complains.line(nothing_written(*arguments))


def test_the_exams_error_is_in_table_answer_and_model_file(armdyn, place):
    (place / "exam.csv").write_text("".join([LINES[0], *LINES[1:250]]))
    command = "add", "m.toml", "sensor_bias", "good.csv", "--exam", "exam.csv", "--output", "out.toml"
    status, out, err = armdyn(*command, "--json", "a.json")
    assert status == 0, err
    assert "Exam: runs that took part in nothing" in out
    answer = json.loads((place / "a.json").read_text())
    assert all(step["exam_rmse"]["load_force"] > 0 for step in answer["steps"])
    assert answer["channels"]["load_force"]["exam_rmse"] == answer["steps"][-1]["exam_rmse"]["load_force"]
    (entry,) = tomllib.loads((place / "out.toml").read_text())["history"]
    assert entry["exam"] == ["exam.csv"]
    assert entry["exam_rmse"]["load_force"] > 0
