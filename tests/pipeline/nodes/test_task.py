"""Plans that are made ahead and beside the loop, and one that comes too late. Planning itself is a stand-in."""

from types import SimpleNamespace

import numpy as np
import pytest

from armdyn.control.task import SwingPlan
from armdyn.errors import TaskFailedError
from armdyn.pendulum.model import pendulum_model
from pipeline.motion import LineState
from pipeline.nodes.task import (
    FIRST_PLAN_LEAD_SECONDS,
    MAX_PLANNING_ATTEMPTS,
    MAX_PLANNING_SECONDS,
    SwingPlanningNode,
    TaskSettings,
    _Planned,
)


class Slow:
    """Work that is done when the test says so."""

    is_synchronous = False

    def __init__(self):
        self.asked = []

    def register(self, name, work):
        pass

    def request(self, _name, _argument, then):
        self.asked.append(then)

    def is_pending(self, _name):
        return bool(self.asked)

    def done(self, planned):
        self.asked.pop()(planned)


@pytest.fixture
def node(monkeypatch):
    monkeypatch.setattr("pipeline.nodes.task.TaskPlanner", lambda *_: None)
    drive = SimpleNamespace(at_rest=True, state=LineState(0.0, 0.0, 0.0), played=[])
    drive.run_trajectory = drive.played.append
    beside, model = Slow(), pendulum_model(0.37, 0.08)
    made = SwingPlanningNode(model, drive, None, None, lambda: np.zeros(7), TaskSettings(cautious=False), beside)
    monkeypatch.setattr(made, "_task", lambda *_, **__: "task")
    made.request_swing(model, lambda _time: 0.0, lambda _time: None)
    return SimpleNamespace(node=made, beside=beside, drive=drive, time=0.0)


def planned(name):
    n = np.zeros(2)
    return _Planned(SwingPlan(n, n, n, n, n, tension=n, load=np.zeros((2, 2)), solution=None), name)


def until(case, time):
    while case.time < time - 1e-9:
        case.node.step(case.time)
        case.time += case.node.period


def test_a_plan_that_came_too_late_is_never_played(node):
    until(node, FIRST_PLAN_LEAD_SECONDS + 1.0)
    node.beside.done(planned("late"))
    until(
        node, node.time + 3.0 * FIRST_PLAN_LEAD_SECONDS
    )  # the next one, for an instant farther ahead, is late as well
    assert node.drive.played == []
    node.beside.done(planned("late again"))
    until(node, node.time + FIRST_PLAN_LEAD_SECONDS)
    node.beside.done(planned("in time"))
    until(node, node.time + 4.0 * FIRST_PLAN_LEAD_SECONDS)
    assert node.drive.played == ["in time"]


@pytest.mark.parametrize("took", [1.5, 3.0, 5.0, 7.5])
def test_a_plan_that_is_not_given_up_begins_within_the_longest_time(node, took):
    while not node.drive.played:
        until(node, node.time + node.node.period)
        if node.beside.asked:
            until(node, node.time + took - node.node.period)
            node.beside.done(planned("plan"))
    assert node.time < MAX_PLANNING_SECONDS


def test_a_computer_that_is_too_busy_is_a_sentence(node, complains):
    for _ in range(MAX_PLANNING_ATTEMPTS):
        until(node, node.time + 10.0 * FIRST_PLAN_LEAD_SECONDS)
        node.beside.done(planned("late"))
    with complains(TaskFailedError):
        until(node, node.time + 0.2)
