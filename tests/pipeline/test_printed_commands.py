"""Every command that a command prints works as it was printed."""

import re
import shlex
from pathlib import Path

import pytest

from pipeline.console.repair_result import repair_output_options

EXAMPLES = Path(__file__).parents[2] / "examples"
PRINTED = re.compile(r"(?:: |')(armdyn [a-z].*?)(?:'|$)")
PLACES = {"RUN...": "{run}", "M.toml": "model.toml", "ROBOT.urdf": "arm.urdf", "ANOTHER.csv": "magnet_2.csv"}
"""What is written in capitals is the reader's to fill in."""


@pytest.fixture
def folder(armdyn, tmp_path):
    for place, rows in (("pendulum", 450), ("ur5", 700)):  # enough for any answer
        for file in (*(EXAMPLES / place).glob("*.csv"), *(EXAMPLES / place).glob("*.toml")):
            (tmp_path / file.name).write_text("".join(file.read_text().splitlines(keepends=True)[:rows]))
    assert armdyn("new", "pendulum", "pendulum.toml")[0] == 0
    assert armdyn("new", "arm", "ur5.toml", "--robot", "ur5")[0] == 0
    return tmp_path


def printed(out, run):
    """Commands in what a command has printed, with the reader's places filled in."""
    for line in out.splitlines():
        for command in PRINTED.findall(line):
            for place, filled in PLACES.items():
                command = command.replace(place, filled.format(run=run))
            yield shlex.split(command)[1:]


GUESSED = ("import", "sweep_1.csv", "--robot", "ur5", "--guess", "--output", "runs")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("commands", "run"),
    [
        ([("new", "pendulum", "a.toml")], "swing_1.csv"),
        pytest.param([("compare", "pendulum.toml", "swing_1.csv", "--held-out", "swing_2.csv")], "swing_1.csv",
                     marks=pytest.mark.slow),
        ([("add", "pendulum.toml", "linear_drag+quadratic_drag", "swing_1.csv", "--output", "r.toml")], "swing_1.csv"),
        ([GUESSED], "runs/sweep_1.csv"),
        ([GUESSED, (*GUESSED[:4], "--map", "runs/map.toml", *GUESSED[5:])], "runs/sweep_1.csv"),
        ([("excite", "--robot", "ur5", "--for", "joint_viscous_friction", "--seconds", "3", "--random", "2",
           "--output", "q.csv")], ""),
        ([("export", "pendulum.toml", "--output", "p.json")], ""),
        pytest.param([("diagnose", "pendulum.toml", "swing_1.csv")], "swing_1.csv", marks=pytest.mark.slow),
        pytest.param([("repair", "pendulum.toml", "swing_1.csv", "--output", "r.toml")], "", marks=pytest.mark.slow),
        pytest.param([("next", "pendulum.toml", "swing_1.csv", "--rivals", "linear_drag,quadratic_drag", "--seconds",
                       "3", "--output", "motion.csv")], "", marks=pytest.mark.slow),
        pytest.param([("discover", "pendulum.toml", "magnet_1.csv", "--held-out", "magnet_2.csv", "--output",
                       "law.py")], "", marks=pytest.mark.slow),
    ],
    ids=lambda given: " ".join(given[-1][:2]) if isinstance(given, list) else "",
)  # fmt: skip
def test_what_is_printed_to_go_on_with_works(armdyn, commands, run):
    for command in commands:
        status, out, err = armdyn(*command)
        assert status in (0, 1), err
    for words in printed(out, run):
        status, _, err = armdyn(*words)
        assert status in (0, 1), (words, err)  # 1: the answer is no


@pytest.mark.slow
def test_an_effect_with_a_state_is_added_compared_repaired_and_swung_with(folder, armdyn):
    (folder / "hose.py").write_text(HOSE)
    own = ("--effects", "hose.py")
    assert armdyn("add", "pendulum.toml", "hose", "swing_1.csv", *own, "--output", "r.toml", "--json", "a.json")[0] == 0
    assert "NaN" not in (folder / "a.json").read_text()
    assert armdyn("compare", "r.toml", "swing_2.csv", *own)[0] == 0
    assert armdyn("repair", "r.toml", "swing_2.csv", *own, "--output", "s.toml")[0] == 0
    status, out, err = armdyn("trial", "--model", "r.toml", *own, "--out", "trial")
    assert status == 0, out + err


HOSE = """from armdyn import effect, quantity


@effect(summary="A hose that follows.", source="Maxwell 1867")
def hose(
    string,
    k=quantity("N m/rad", typical=0.005, lower=0.0),
    time=quantity("s", typical=0.2, null=0.3, lower=0.02, upper=5.0, spread=0.2),
):
    string, z = string.with_state(lambda z: string.rate - z / time)
    return string.with_torque(-k * z)
"""
PLAY = """import casadi as ca

from armdyn import effect, quantity


@effect(acts_on="joint", summary="Backlash.", source="armdyn discover")
def play(
    joint,
    k=quantity("N m", typical=0.8, lower=0.0),
    travel=quantity("rad", typical=0.005, null=0.01, lower=0.0005, upper=0.2, spread=0.005),
    start=quantity("1", typical=1.0, lower=-1.0, upper=1.0, spread=1.0, scope="per_run"),
):
    speed = joint.velocity
    joint, turned = joint.with_state(lambda z: speed * (1 - ca.fmax(0, z * ca.sign(speed))**8) / travel, start)
    return joint.with_torque(k * turned)
"""


def test_a_backlash_as_discover_writes_it_is_added_and_compared(folder, armdyn):
    (folder / "play.py").write_text(PLAY)
    own = ("--effects", "play.py")
    for command in (GUESSED, (*GUESSED[:4], "--map", "runs/map.toml", *GUESSED[5:])):
        assert armdyn(*command)[0] == 0
    run = "runs/sweep_1.csv"
    added = armdyn("add", "ur5.toml", "play:elbow_joint", run, *own, "--output", "r.toml", "--json", "a.json")
    assert added[0] == 0, added
    assert "NaN" not in (folder / "a.json").read_text()
    assert armdyn("compare", "r.toml", run, *own)[0] == 0


def test_a_proposed_repair_never_writes_over_the_model_that_it_reads():
    for name in ("m.toml", "repaired.toml", "repaired_again.toml"):
        option, output, *_ = repair_output_options(Path(name))
        assert (option, output != name) == ("--output", True)
