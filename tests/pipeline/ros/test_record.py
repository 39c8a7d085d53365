"""Recording a ROS robot, checking from where it is, and what its commands refuse."""

import json
import signal
import threading

import numpy as np
import pytest
from ros_wire.messages import TOPICS, joint_states

from armdyn.errors import InputError, TaskFailedError
from armdyn.run import read_run
from pipeline.ros.record import record_run
from pipeline.ros.states import present_joint_state


def state(baxter, k, late=0.0, **fields):
    given = {"position": [0.003 * k] * 7, "velocity": [0.3] * 7, "effort": [1.0] * 7} | fields
    return joint_states(baxter.joint_names, 100.0 + 0.01 * k - late, **given)


@pytest.fixture
def moving(loopback, baxter, speaking):
    """An arm whose joint s0 turns."""
    still = {"velocity": [0.3, *[0.0] * 6]}
    speaking(lambda k: [state(baxter, k, position=[0.003 * k, *baxter.home[1:]], **still)])
    return loopback


def test_a_recording_is_a_run(moving, baxter, tmp_path):
    file = tmp_path / "run.csv"
    record_run(moving.uri, baxter, TOPICS, file, 0.5)
    run = read_run(file)
    assert set(run.channels) == {f"{kind}.{name}" for kind in ("q", "v", "tau") for name in baxter.joint_names}
    turning, still = run.channels["q.right_s0"], run.channels["q.right_e1"]
    assert len(turning) > 5
    assert np.all(np.diff(turning.time) > 0)
    assert np.all(np.diff(turning.value) > 0)
    assert still.value == pytest.approx(baxter.home[3])
    assert run.channels["v.right_s0"].value == pytest.approx(0.3)
    assert run.channels["tau.right_s0"].value == pytest.approx(1.0)
    assert {r["op"] for r in moving.requests} == {"subscribe"}  # nothing is published


@pytest.mark.parametrize(
    ("messages", "says", "lacks"),
    [
        (lambda b, k: [state(b, k, late=-0.48 * (k % 40 == 20))], "whose stamp", ()),
        (lambda b, k: [state(b, k, late=50.0 * (k % 40 == 20))], "whose stamp goes back", ()),
        (lambda b, k: [state(b, k), state(b, k)], "whose stamp was there already", ()),
        (lambda b, k: [state(b, k), state(b, k, position=[0.0] * 7, velocity=[], effort=[])],
         "of a second publisher that does not move", ()),
        (lambda b, k: [state(b, k, effort=[])], "no tau of right_s0", ("tau",)),
        (lambda b, k: [state(b, k, velocity=[], effort=[0.0] * 7)], "no v of right_s0", ("v", "tau")),
        (lambda b, k: [state(b, k, effort=[None] * 7)], "no tau of right_s0", ("tau",)),
        (lambda b, k: [state(b, k), {"name": list(b.joint_names), "position": "?"}], "nothing can be read", ()),
    ],
)  # fmt: skip
def test_every_message_is_accounted_for(loopback, baxter, speaking, tmp_path, messages, says, lacks):
    """What was not sent is missing, one bad stamp costs one sample, and what follows it is dated as before."""
    speaking(lambda k: messages(baxter, k))
    _, said = record_run(loopback.uri, baxter, TOPICS, tmp_path / "run.csv", 0.7)
    assert says in " ".join(said)
    run = read_run(tmp_path / "run.csv")
    assert {name.partition(".")[0] for name in run.channels} == {"q", "v", "tau"} - set(lacks)
    q = run.channels["q.right_s0"]
    slope = np.polynomial.Polynomial.fit(q.time, q.value, 1)
    assert np.abs(slope(q.time) - q.value).max() < 0.003  # 0.3 rad/s: no sample is dated 10 ms wrong


def test_joints_that_two_nodes_publish_are_one_run(loopback, baxter, speaking, tmp_path):
    def halves(k):
        both = state(baxter, k)
        for part in (slice(0, 3), slice(3, 7)):
            yield {f: both[f][part] if f != "header" else both[f] for f in both}

    speaking(halves)
    record_run(loopback.uri, baxter, TOPICS, tmp_path / "run.csv", 0.3)
    assert read_run(tmp_path / "run.csv").joints == tuple(baxter.joint_names)


def test_a_joint_that_is_never_sent_is_named(loopback, baxter, speaking, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.ros.record.FIRST_STATE_TIMEOUT_SECONDS", 0.5)
    speaking(lambda k: [state(baxter, k, name=[*baxter.joint_names[:6], "gripper"])])
    with pytest.raises(InputError, match=r"no state of right_w2 within 3 s; what came is of right_s0, .*gripper"):
        record_run(loopback.uri, baxter, TOPICS, tmp_path / "run.csv", 0.5)


@pytest.mark.parametrize(
    ("after", "fail", "says"),
    [
        (0.3, lambda arm: arm.stopped.set(), "nothing came for 0.5 s"),
        (0.6, lambda arm: arm.drop(), "connection to the bridge .* is lost.*"),
    ],
)
def test_what_came_before_the_states_stop_is_kept(moving, baxter, tmp_path, monkeypatch, after, fail, says):
    if says.startswith("nothing"):
        monkeypatch.setattr("pipeline.ros.record.MAX_STATE_GAP_SECONDS", 0.5)
    threading.Timer(after, fail, [moving]).start()
    with pytest.raises(TaskFailedError, match=says + r"; the 0\.\d s of 30 s that came are in"):
        record_run(moving.uri, baxter, TOPICS, tmp_path / "run.csv", 30.0)
    assert len(read_run(tmp_path / "run.csv").channels["q.right_s0"]) >= 10


def test_a_signal_ends_a_recording_early_and_it_is_kept(moving, baxter, tmp_path):
    threading.Timer(0.6, signal.raise_signal, (signal.SIGINT,)).start()
    run, said = record_run(moving.uri, baxter, TOPICS, tmp_path / "run.csv", 30.0)
    assert "ended by a signal; the 0." in said[-1]
    assert len(read_run(tmp_path / "run.csv").channels["q.right_s0"]) == len(run.channels["q.right_s0"])


def test_check_starts_from_where_the_arm_is(armdyn, baxter, moving, tmp_path):
    state = present_joint_state(moving.uri, baxter.joint_names, TOPICS.joint_states)
    assert state.q[1:] == pytest.approx(np.array(baxter.home)[1:])
    (tmp_path / "s.csv").write_text("time [s],s [m]\n" + "".join(f"{0.01 * k},0.0\n" for k in range(10)))
    assert armdyn("check", "s.csv", "--ros", moving.uri, "--json", "answer.json")[0] == 1
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert any(violation["limit"].startswith("start") for violation in answer["violations"])


ROS = ("--robot", "ros", "--ros", "ws://127.0.0.1:1")
USELESS = [
    (("--robot", "panda"), "choose 'simulated' or 'ros'"), ((*ROS,), "give --loadcell PORT, or rehearse"),
    (("--ros", "ws://localhost:1"), "--ros: needs a real robot, such as --robot ros"),
    (("--loadcell", "COM3"), "--loadcell: needs a real robot, such as --robot ros"),
    ((*ROS, "--rehearse"), "no rosbridge answers there"),
    (("--robot", "ros:ws://127.0.0.1:1", "--rehearse"), "no rosbridge answers there"),
    ((*ROS, "--hidden", "wind"), "only the simulated robot has it"),
    ((*ROS, "--rehearse", "--landed", "maybe"), "say 'yes' or 'no'"),
    ((*ROS, "--rehearse", "--arm", "panda"), "there is no table"), (("--mass", "heavy"), "--mass"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "says"), USELESS)
def test_what_cannot_be_used_is_one_line_and_status_2(refused, arguments, says):
    assert says in refused("trial", *arguments)


def test_a_file_is_a_driver(refused, monkeypatch, tmp_path):
    from pipeline.robot import drivers

    (tmp_path / "mine.py").write_text(
        "from armdyn.errors import InputError\nfrom pipeline.robot.drivers import Driver\n\n\n"
        "def reach(address, arm, description):\n"
        "    raise InputError(f'{address}: {arm} with {len(description.joint_names)} joints is not there')\n\n\n"
        "DRIVER = Driver('mine', 'its host', reach)\n"
    )
    monkeypatch.setattr(drivers, "__path__", [*drivers.__path__, str(tmp_path)])
    drivers.known_drivers.cache_clear()
    try:
        said = refused("trial", "--robot", "mine:10.0.0.2", "--rehearse")
        assert said == "armdyn: 10.0.0.2: baxter with 7 joints is not there\n"
        assert "--robot mine:ADDRESS, its host" in refused("trial", "--robot", "mine")
    finally:
        drivers.known_drivers.cache_clear()
