import json
import re

import numpy as np
import pytest
from command import called

import urdf
from armdyn.run import read_run
from pipeline.motion.feasibility import check_joints
from pipeline.motion.feasibility.read import read_trajectory

SMALL = ("--joints", "right_s0,right_s1,right_e0", "--seconds", "5", "--random", "3", "--no-compare")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Motion and JSON of one small design, and what was printed."""
    folder = tmp_path_factory.mktemp("excite")
    words = ["excite", "--robot", "baxter", "--for", "joint_viscous_friction,payload", *SMALL]
    status, out, _ = called(*words, "--output", folder / "motion.csv", "--json", folder / "motion.json")
    assert status == 0
    return folder / "motion.csv", json.loads((folder / "motion.json").read_text()), out


def test_the_motion_is_a_feasible_run_that_starts_and_ends_at_rest(made):
    file, answer, _ = made
    robot = urdf.load("baxter", joints=answer["joints"])
    assert check_joints(robot, read_trajectory(file, robot)).feasible
    assert answer["feasible"] is True
    run = read_run(file)
    assert run.joints == tuple(answer["joints"])
    for joint in answer["joints"]:
        q, v, a = (run.channels[f"{kind}.{joint}"] for kind in "qva")
        assert (q.unit, v.unit, a.unit) == ("rad", "rad/s", "rad/s^2")
        assert max(np.abs(x.value[[0, -1]]).max() for x in (v, a)) < 1e-9
        assert np.abs(v.value).max() > 0.05
    assert len(q) == answer["samples"] == 501


def test_the_answer_says_what_is_expected_beside_the_best_random_motion(made):
    _, answer, printed = made
    assert list(answer["taken_as_known"]) == ["link_inertia"]
    assert len(answer["unknowns"]) == 7
    assert all(u["std"] > 0 and u["random_std"] > 0 for u in answer["unknowns"])
    assert {u["condition_number_std"] for u in answer["unknowns"]} == {None}
    ratios = [u["random_std"] / u["std"] for u in answer["unknowns"] if u["determined"]]
    gain = answer["times_better_than"]["random"]
    assert gain == pytest.approx(np.exp(np.mean(np.log(ratios))))
    assert gain > 1.0
    said = float(re.search(r"are (\S+) times smaller than with the best of 3 random motions", answer["sentence"])[1])
    assert said == pytest.approx(gain, rel=0.06)  # two digits are said
    assert answer["sentence"] in printed
    assert all(peak[what]["share"] <= 1.0 for peak in answer["peaks"] for what in ("speed", "acceleration", "torque"))
    assert answer["energy"] > 0


BAXTER = ("--robot", "baxter")
BAD = [
    *((*BAXTER, "--for", name) for name in (
        "joint_viscos_friction", "linear_drag", "payload,payload", " , ", "torque_delay", "payload:right_w9")),
    (*BAXTER, "--joints", "right_x0"), (*BAXTER, "--rivals", "payload"), (*BAXTER, "--rivals", "payload,payload"),
    (*BAXTER, "--for", "payload", "--rivals", "payload,torque_offset"), ("--robot", "baxtr"),
    (*BAXTER, "--urdf", "a.urdf"), (), ("--urdf", "none.urdf"),
    *((*BAXTER, "--seconds", seconds) for seconds in ("0", "nan", "1e9")), (*BAXTER, "--rate", "inf"),
    (*BAXTER, "--random", "0"), (*BAXTER, "--seed", "-1"), (*BAXTER, "--output", "no/where.csv"),
    (*BAXTER, "--report", "motion.csv"),
]  # fmt: skip


@pytest.mark.parametrize("words", BAD)
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
