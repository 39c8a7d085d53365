"""What is shown while a command works."""

import re
import subprocess
import sys

import numpy as np
import pytest
from worlds.pendulum import Setup, record, weighed

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.units import KnownQuantity
from pipeline.console.screen import PROGRESS_COUNT_PATTERN, remaining_time_text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(3.0, "a few seconds left"), (42.0, "about 40 s left"), (89.0, "about 90 s left"), (300.0, "about 5 min left")],
)
def test_time_that_is_left_is_as_coarse_as_it_is_known(seconds, text):
    assert remaining_time_text(seconds) == text


def test_a_repair_says_how_many_candidates_of_how_many_are_tried():
    told = []
    catalogue = [CATALOGUE[name] for name in ("linear_drag", "quadratic_drag", "sensor_bias")]
    setup = Setup(hidden={"quadratic_drag": 0.02})
    run = weighed(
        record("a.csv", setup, np.random.default_rng(7)),
        KnownQuantity(0.08, 4e-4, "kg"),
        KnownQuantity(0.368, 1e-3, "m"),
    )
    repair(make_study(pendulum_model(0.368, 0.08), [run], [], catalogue), told.append)
    counts = [tuple(map(int, found.groups())) for text in told if (found := PROGRESS_COUNT_PATTERN.match(text))]
    assert any(re.fullmatch(r"\d+ of \d+ candidates tried, now [\w, ]+", text) for text in told)
    assert all(done < total for done, total in counts)
    assert {done for done, _ in counts} >= {0, 1}


CODE = """
import os, threading
from pipeline.processes import HighPriorityThread, request_real_time_priority

ready, rank = threading.Event(), {}

def receive():
    ready.wait()
    rank["then"] = os.sched_getparam(0).sched_priority

def guard():
    rank["later"] = os.sched_getparam(0).sched_priority

receiving = HighPriorityThread(receive, "receiving")
receiving.start()
granted = request_real_time_priority()
ready.set()
receiving.join()
guarding = HighPriorityThread(guard, "guarding")
guarding.start()
guarding.join()
print(granted, rank["then"], rank["later"], os.sched_getparam(0).sched_priority)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ranks are asked for as Linux has them")
def test_what_receives_goes_before_what_computes():
    said = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True).stdout.split()
    if said[0] == "False":
        assert said[1:] == ["0", "0", "0"]
        pytest.skip("this system grants no real-time scheduling")
    already_there, later, computing = map(int, said[1:])
    assert already_there == later > computing > 0
