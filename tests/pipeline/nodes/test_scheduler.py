import threading
from time import sleep

from armdyn.errors import InputError
from pipeline.nodes.scheduler import Scheduler, Watchdog


class Clock:
    """Time that moves only when told, and when a node takes its time."""

    def __init__(self):
        self.time = 0.0

    def advance(self, duration):
        self.time += duration


class Recording:
    def __init__(self, name, period, log, clock=None, takes=0.0):
        self.name, self.period, self._log, self._clock, self._takes = name, period, log, clock, takes

    def step(self, now):
        self._log.append((self.name, round(now, 6)))
        if self._clock is not None:
            self._clock.time += self._takes


def never():
    return False


def test_each_node_runs_at_its_own_rate_in_the_given_order():
    clock, log = Clock(), []
    scheduler = Scheduler(clock, [Recording("fast", 0.01, log), Recording("slow", 0.05, log)])
    scheduler.run(never, 0.1)
    assert [t for name, t in log if name == "slow"] == [0.0, 0.05, 0.1]
    assert sum(name == "fast" for name, _ in log) == 11
    assert log[:2] == [("fast", 0.0), ("slow", 0.0)]


def test_a_slow_node_is_counted_and_does_not_pile_up_work():
    clock, log = Clock(), []
    lazy = Recording("lazy", 0.01, log, clock, takes=0.025)
    scheduler = Scheduler(clock, [lazy])
    scheduler.run(never, 0.1)
    assert scheduler.timing["lazy"].skipped >= 4
    assert len(log) <= 6


def test_it_stops_when_the_condition_holds():
    clock, log = Clock(), []
    scheduler = Scheduler(clock, [Recording("node", 0.01, log)])
    assert scheduler.run(lambda: len(log) == 3, 1.0)
    assert len(log) == 3
    assert not scheduler.run(never, 0.05)


def test_runs_continue_where_the_last_one_ended():
    clock, log = Clock(), []
    scheduler = Scheduler(clock, [Recording("node", 0.02, log)])
    scheduler.run(never, 0.03)
    scheduler.run(never, 0.03)
    assert [t for _, t in log] == [0.0, 0.02, 0.04, 0.06]


def test_a_period_that_is_not_positive_is_refused(complains):
    with complains(InputError):
        Scheduler(Clock(), [Recording("node", 0.0, [])])


PATIENCE = 0.03


def test_it_stops_the_arm_once_while_the_loop_hangs(until):
    stopped = []
    with Watchdog(lambda: stopped.append(threading.current_thread().name), lambda: True, PATIENCE) as dog:
        until(lambda: stopped)  # this thread does not beat: it hangs
        sleep(3 * PATIENCE)
    assert stopped == ["watchdog"]
    assert "had not come round" in dog.fault


def test_an_arm_that_stands_is_left_alone():
    stopped = []
    with Watchdog(lambda: stopped.append(1), lambda: False, PATIENCE) as dog:
        sleep(4 * PATIENCE)
    assert not stopped
    assert dog.fault is None


def test_a_loop_that_beats_is_left_alone():
    stopped, patience = [], 5.0  # far above what a busy machine delays a thread
    with Watchdog(lambda: stopped.append(1), lambda: True, patience) as dog:
        for _ in range(20):
            dog.beat()
            sleep(0.005)
    assert not stopped


def test_what_stopping_raises_is_told(until):
    def broken():
        raise OSError("link")

    with Watchdog(broken, lambda: True, PATIENCE) as dog:
        until(lambda: dog.fault is not None and "link" in dog.fault)
