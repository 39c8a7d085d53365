import json
import re

import numpy as np
import pytest

import urdf
from armdyn.run import read_run

SMALL = ("--joints", "right_s0,right_s1,right_e0", "--seconds", "5", "--random", "3", "--no-compare")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Motion, report and JSON of one small design."""
    from typer.testing import CliRunner

    from pipeline.console.app import build_application

    folder = tmp_path_factory.mktemp("excite")
    files = {name: folder / f"motion.{name}" for name in ("csv", "html", "json")}
    words = ["excite", "--robot", "baxter", "--for", "joint_viscous_friction,payload", *SMALL]
    words += ["--output", files["csv"], "--report", files["html"], "--json", files["json"]]
    result = CliRunner().invoke(build_application(["excite"]), list(map(str, words)), standalone_mode=False)
    assert result.exception is None
    return files, json.loads(files["json"].read_text()), result.output


def test_the_motion_passes_the_feasibility_check(made):
    from pipeline.motion.feasibility import check_joints
    from pipeline.motion.feasibility.read import read_trajectory

    files, answer, _ = made
    robot = urdf.load("baxter", joints=answer["joints"])
    assert check_joints(robot, read_trajectory(files["csv"], robot)).feasible
    assert answer["feasible"] is True


def test_the_motion_is_a_run_of_the_contract_that_starts_and_ends_at_rest(made):
    files, answer, _ = made
    run = read_run(files["csv"])
    assert run.joints == tuple(answer["joints"])
    for joint in answer["joints"]:
        q, v, a = (run.channels[f"{kind}.{joint}"] for kind in "qva")
        assert (q.unit, v.unit, a.unit) == ("rad", "rad/s", "rad/s^2")
        assert np.abs(v.value[[0, -1]]).max() < 1e-9
        assert np.abs(a.value[[0, -1]]).max() < 1e-9
        assert np.abs(v.value).max() > 0.05
    assert len(q) == answer["samples"] == 501


def test_the_answer_says_what_is_expected_beside_the_best_random_motion(made):
    _, answer, printed = made
    assert answer["schema"] == "armdyn.excite/1"
    assert answer["for"] == ["joint_viscous_friction", "payload"]
    assert list(answer["taken_as_known"]) == ["link_inertia"]
    assert len(answer["unknowns"]) == 7
    for unknown in answer["unknowns"]:
        assert unknown["std"] > 0
        assert unknown["random_std"] > 0
        assert unknown["condition_number_std"] is None
    ratios = [u["random_std"] / u["std"] for u in answer["unknowns"] if u["determined"]]
    gain = answer["times_better_than"]["random"]
    assert gain == pytest.approx(np.exp(np.mean(np.log(ratios))))
    assert gain > 1.0
    assert answer["times_better_than"]["condition_number"] is None
    said = float(re.search(r"are (\S+) times smaller than with the best of 3 random motions", answer["sentence"])[1])
    assert said == pytest.approx(gain, rel=0.06)  # two digits are said
    assert answer["sentence"] in printed
    assert all(peak[what]["share"] <= 1.0 for peak in answer["peaks"] for what in ("speed", "acceleration", "torque"))
    assert answer["energy"] > 0


@pytest.mark.parametrize(
    "words",
    [
        ("--robot", "baxter", "--for", "joint_viscos_friction"),
        ("--robot", "baxter", "--for", "linear_drag"),
        ("--robot", "baxter", "--for", "payload,payload"),
        ("--robot", "baxter", "--for", " , "),
        ("--robot", "baxter", "--for", "torque_delay"),
        ("--robot", "baxter", "--for", "payload:right_w9"),
        ("--robot", "baxter", "--joints", "right_x0"),
        ("--robot", "baxter", "--rivals", "payload"),
        ("--robot", "baxter", "--rivals", "payload,payload"),
        ("--robot", "baxter", "--for", "payload", "--rivals", "payload,torque_offset"),
        ("--robot", "baxtr"),
        ("--robot", "baxter", "--urdf", "a.urdf"),
        (),
        ("--urdf", "none.urdf"),
        ("--robot", "baxter", "--seconds", "0"),
        ("--robot", "baxter", "--seconds", "nan"),
        ("--robot", "baxter", "--seconds", "1e9"),
        ("--robot", "baxter", "--rate", "inf"),
        ("--robot", "baxter", "--random", "0"),
        ("--robot", "baxter", "--seed", "-1"),
        ("--robot", "baxter", "--output", "no/where.csv"),
        ("--robot", "baxter", "--report", "motion.csv"),
    ],
)
def test_bad_input_is_one_line_and_status_2(refused, words, tmp_path, complains):
    output = () if "--output" in words else ("--output", "motion.csv")
    complains.line(refused("excite", *output, *words))
    assert not list(tmp_path.iterdir())


def test_what_no_motion_can_do_is_status_1(armdyn, tmp_path):
    """About the first joint's vertical axis, a rotor is as good as a link."""
    rivals = "rotor_inertia:right_s0,link_inertia:right_s0"
    words = ("--robot", "baxter", "--joints", "right_s0", "--rivals", rivals, "--output", "a.csv")
    status, _, err = armdyn("excite", *words)
    assert status == 1
    assert "no motion can tell rotor_inertia from link_inertia" in err
    assert not list(tmp_path.iterdir())
