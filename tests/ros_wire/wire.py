"""Master, bridge, twin and trial in processes of their own, and what can be done to them."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

KIT = os.environ.get("ARMDYN_ROS_KIT")
"""Folder of a ROS test kit: its start.sh starts a master and a rosbridge on loopback and says where they are."""
PACKAGES = ("rosmaster", "rospy", "sensor_msgs", "trajectory_msgs", "autobahn", "twisted", "tornado", "bson", "PIL")
"""What the kit needs in the system's Python."""
TESTS = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}


def missing():
    """Why there is no ROS here; None where there is."""
    if not KIT or not (Path(KIT) / "start.sh").is_file():
        return "ARMDYN_ROS_KIT does not name a ROS test kit (a folder with start.sh; see docs/robot.md)"
    test = "; ".join(f"import {name}" for name in PACKAGES)
    if subprocess.run(["/usr/bin/python3", "-c", test], capture_output=True, check=False).returncode:
        return "the system's Python lacks ROS: apt install python3-rosmaster python3-rospy ... (see docs/robot.md)"
    return None


def real_time(pid):
    """Let all threads of a process run before ordinary programs, but after twin and trial, where that is granted.

    Here the bridge looks through its memory for 60 ms now and then; on a robot it has a computer of its own.
    """
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(5))
        except OSError:
            return


class Stalls:
    """Sees how long [s] this machine keeps even a real-time thread from running, on the processor that is worst."""

    def __init__(self):
        self.worst = 0.0
        code = (
            "import os, sys, time\n"
            "os.sched_setaffinity(0, {int(sys.argv[1])})\n"
            "try:\n os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(20))\nexcept OSError:\n pass\n"
            "while True:\n before = time.monotonic(); time.sleep(0.005); late = time.monotonic() - before - 0.005\n"
            " if late > 0.01: print(late, flush=True)\n"
        )
        self._processes = [
            subprocess.Popen([sys.executable, "-c", code, str(cpu)], stdout=subprocess.PIPE, text=True)
            for cpu in os.sched_getaffinity(0)
        ]
        for process in self._processes:
            threading.Thread(target=self._watch, args=(process,), daemon=True).start()

    def _watch(self, process):
        for line in process.stdout:
            self.worst = max(self.worst, float(line))

    def close(self):
        for process in self._processes:
            process.kill()
            process.wait()
            process.stdout.close()


class Running:
    """A process that is killed at the end of a ``with`` block."""

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.process.kill()
        self.process.wait()


class Wire(Running):
    """A master and a bridge, their addresses, and numbers of processes by name, such as ``BRIDGE_PID``."""

    def __init__(self):
        self.process = subprocess.Popen(
            [str(Path(KIT) / "start.sh"), "0", "0"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        said = {}
        for line in self.process.stdout:
            if line.strip() == "READY":
                break
            name, _, value = line.strip().partition("=")
            said[name] = value
        self.uri, self.master = said["ROSBRIDGE_URL"], said["ROS_MASTER_URI"]
        self.pids = {name: int(value) for name, value in said.items() if name.endswith("_PID")}
        for pid in self.pids.values():
            real_time(pid)

    def __exit__(self, *_error):
        self.process.stdin.close()
        self.process.wait(20)
        self.process.stdout.close()


class TracedTwin(Running):
    """The twin's process, with the port of its load cell and the file of the cell's calibration."""

    def __init__(self, wire, folder, seed=0, hidden=()):
        self.calibration, self._trace = folder / "cell.toml", folder / "trace.npz"
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("traced_twin.py")), wire.uri, str(self.calibration),
             str(self._trace), str(seed), *hidden],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT,
        )  # fmt: skip
        self.port = next(line.split()[1] for line in self.process.stdout if line.startswith("loadcell"))
        assert self.process.stdout.readline() == "READY\n"

    def tell(self, word):
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()

    def end(self):
        """End it; the trace."""
        if self.process.poll() is None:
            self.process.stdin.close()
            self.process.wait(30)
            self.process.stdout.close()
        return dict(np.load(self._trace))


class Trial(Running):
    """The process of ``armdyn trial --robot ros``, with standard error and output in one pipe."""

    def __init__(self, wire, twin, folder, *options):
        self._answer, self.out = folder / "trial.json", folder / "out"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "pipeline.cli", "trial", "--robot", "ros", "--ros", wire.uri, "--loadcell",
             twin.port, "--calibration", str(twin.calibration), "--yes", "--landed", "yes", "--out", str(self.out),
             "--json", str(self._answer), *options],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ENVIRONMENT, cwd=folder,
        )  # fmt: skip

    @property
    def runs(self):
        return self.process.poll() is None

    def wait(self):
        """Exit status, what was said, and the answer; None where there is none."""
        said, _ = self.process.communicate(timeout=240)
        answer = json.loads(self._answer.read_text()) if self._answer.is_file() else None
        return self.process.returncode, said, answer


def suspend(pid, seconds):
    """Stop a process for a while."""
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)
