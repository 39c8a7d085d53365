import threading
from time import sleep
from types import SimpleNamespace

import pytest

from armdyn.errors import InputError
from pipeline.nodes.scheduler import Scheduler, Watchdog


class Clock:
    """Time that moves only when told, and when a node takes its time."""

    time = 0.0

    def advance(self, duration):
        self.time += duration


@pytest.fixture
def scheduler():
    """Makes one of nodes (name, period, seconds that a step takes); it has the log of their steps."""

    def make(*nodes):
        clock, log = Clock(), []

        def node(name, period, takes=0.0):
            def step(now):
                log.append((name, round(now, 6)))
                clock.advance(takes)

            return SimpleNamespace(name=name, period=period, step=step)

        made = Scheduler(clock, [node(*each) for each in nodes])
        made.log = log
        return made

    return make


def never():
    return False


def test_each_node_runs_at_its_own_rate_in_the_given_order(scheduler):
    made = scheduler(("fast", 0.01), ("slow", 0.05))
    made.run(never, 0.1)
    assert [t for name, t in made.log if name == "slow"] == [0.0, 0.05, 0.1]
    assert sum(name == "fast" for name, _ in made.log) == 11
    assert made.log[:2] == [("fast", 0.0), ("slow", 0.0)]


def test_a_slow_node_is_counted_and_does_not_pile_up_work(scheduler):
    made = scheduler(("lazy", 0.01, 0.025))
    made.run(never, 0.1)
    assert made.timing["lazy"].skipped >= 4
    assert len(made.log) <= 6


def test_it_stops_when_the_condition_holds_and_goes_on_where_it_ended(scheduler):
    made = scheduler(("node", 0.02))
    assert made.run(lambda: len(made.log) == 3, 1.0)
    assert len(made.log) == 3
    for _ in range(2):
        assert not made.run(never, 0.03)
    assert [t for _, t in made.log] == [0.0, 0.02, 0.04, 0.06, 0.08, 0.1]


def test_a_period_that_is_not_positive_is_refused(scheduler, complains):
    with complains(InputError):
        scheduler(("node", 0.0))


PATIENCE = 0.03


def test_it_stops_the_arm_once_while_the_loop_hangs(until):
    stopped = []

    def stop():
        stopped.append(threading.current_thread().name)
        raise OSError("link")

    with Watchdog(stop, lambda: True, PATIENCE) as dog:
        until(lambda: dog.fault is not None and "link" in dog.fault)  # this thread does not beat: it hangs
        sleep(3 * PATIENCE)
    assert stopped == ["watchdog"]


@pytest.mark.parametrize(("moves", "patience"), [(False, PATIENCE), (True, 5.0)])
def test_an_arm_that_stands_and_a_loop_that_beats_are_left_alone(moves, patience):
    """The second patience is far above what a busy machine delays a thread."""
    stopped = []
    with Watchdog(lambda: stopped.append(1), lambda: moves, patience) as dog:
        for _ in range(4):
            dog.report_alive()
            sleep(1.1 * PATIENCE)
    assert not stopped
    assert dog.fault is None
