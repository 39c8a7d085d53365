"""Real-time ranks, in a process of its own: they would stay with the tests that follow."""

import subprocess
import sys

import pytest

CODE = """
import os, threading
from pipeline.processes import PromptThread, ask_for_real_time

ready, rank = threading.Event(), {}

def receive():
    ready.wait()
    rank["then"] = os.sched_getparam(0).sched_priority

def guard():
    rank["later"] = os.sched_getparam(0).sched_priority

receiving = PromptThread(receive, "receiving")
receiving.start()
granted = ask_for_real_time()
ready.set()
receiving.join()
guarding = PromptThread(guard, "guarding")
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
