import os
import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import get_cached_controller, threadpool_info, threadpool_limits

import armdyn
from armdyn.experiments.goal import goal_to_determine
from armdyn.identify.estimator import Estimator
from armdyn.identify.problem import Problem
from armdyn.identify.studies import make_study
from armdyn.threads import one_thread
from ik.child_processes import worker_pool
from pipeline.cli import ONE_THREAD_ENVIRONMENT
from pipeline.motion.excitation import design_excitation

OUTSIDE = 3  # threads that a user has given to linear algebra


def threads():
    """Of each copy of a library of linear algebra in this process."""
    return {library["num_threads"] for library in get_cached_controller().info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def outside():
    with threadpool_limits(OUTSIDE, "blas"):
        yield


@pytest.fixture
def seen(monkeypatch):
    """How many threads there were when residuals were computed."""
    found, blocks = set(), Problem.blocks

    def watched(*arguments, **options):
        found.update(threads())
        return blocks(*arguments, **options)

    monkeypatch.setattr(Problem, "blocks", watched)
    return found


@pytest.fixture
def model():
    return armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")


@pytest.fixture
def run():
    time = 0.02 * np.arange(100)
    swing = 0.3 * np.exp(-0.1 * time) * np.cos(5.2 * time) + 1e-3 * np.random.default_rng(0).normal(size=100)
    return armdyn.Run.from_arrays(time, {"swing_angle": swing}, name="a")


OWN = """
import sys
import scipy.linalg
from threadpoolctl import threadpool_info
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

print(*(library["num_threads"] for library in threadpool_info()), file=sys.stderr)

@effect("own", acts_on="load", summary="A push.", source="none")
def own(load, size=quantity("N", typical=1.0)):
    return load.with_force(size * load.velocity)
"""
"""A file of effects that says how many threads the command has that reads it."""

DRAG = [armdyn.CATALOGUE["linear_drag"]]
QUESTIONS = {
    "fit": lambda model, run: armdyn.fit(model, [run]),
    "compare": lambda model, run: armdyn.compare(model, [run]),
    "diagnose": lambda model, run: armdyn.diagnose(model, [run], effects=DRAG),
    "repair": lambda model, run: armdyn.repair(model, [run], effects=DRAG),
    "a study": lambda model, run: make_study(model, [run], [], []).first(),
    "an estimator": lambda model, run: Estimator(model, {"swing_angle": 1e-3}).update(run),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_is_answered_by_one_thread_and_gives_the_others_back(question, seen, model, run):
    QUESTIONS[question](model, run)
    assert seen == {1}
    assert threads() == {OUTSIDE}


def test_a_motion_is_designed_by_one_thread():
    seen = set()
    goal = goal_to_determine(armdyn.arm.arm_model(robot="ur5"), [armdyn.CATALOGUE["joint_viscous_friction"]], 50.0)
    design_excitation(goal, 2.0, random=1, compare=False, say=lambda _: seen.update(threads()))
    assert seen == {1}
    assert threads() == {OUTSIDE}


def test_a_call_within_another_gives_nothing_back():
    inner = one_thread(lambda: None)
    assert one_thread(lambda: [inner(), threads()])()[1] == {1}
    assert threads() == {OUTSIDE}


def test_an_error_gives_the_threads_back():
    with pytest.raises(armdyn.InputError):
        armdyn.compare(armdyn.pendulum.pendulum_model(length=0.36, mass=0.1), [])
    assert threads() == {OUTSIDE}


@pytest.mark.parametrize("start", ["spawn", "forkserver", "fork"])
def test_workers_have_one_thread(start):
    with worker_pool(1, start) as pool:
        libraries = pool.submit(threadpool_info).result()
    assert {library["num_threads"] for library in libraries if library["user_api"] == "blas"} == {1}


def test_a_command_has_one_thread_whatever_the_environment_says(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    command = [sys.executable, "-m", "pipeline.cli", "effects", "--effects", "own.py"]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        **dict.fromkeys(ONE_THREAD_ENVIRONMENT, str(OUTSIDE)),
    }
    said = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stderr
    assert set(said.split()) == {"1"}
