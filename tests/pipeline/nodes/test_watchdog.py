import threading
from time import monotonic, sleep

from pipeline.nodes.scheduler import Watchdog

PATIENCE = 0.03


def until(condition, patience=10.0):
    end = monotonic() + patience
    while not condition() and monotonic() < end:
        sleep(0.002)
    return condition()


def test_it_stops_the_arm_once_while_the_loop_hangs():
    stopped = []
    with Watchdog(lambda: stopped.append(threading.current_thread().name), lambda: True, PATIENCE) as dog:
        assert until(lambda: stopped)  # this thread does not beat: it hangs
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


def test_what_stopping_raises_is_told():
    def broken():
        raise OSError("link")

    with Watchdog(broken, lambda: True, PATIENCE) as dog:
        assert until(lambda: dog.fault is not None and "link" in dog.fault)
