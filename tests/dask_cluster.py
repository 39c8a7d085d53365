"""A real dask cluster for tests: a scheduler and two workers, each a process of its own."""

import os
import socket
import subprocess
import sys
from contextlib import contextmanager


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def dask_cluster(folder):
    """Address, and the processes: scheduler first."""
    address = f"tcp://127.0.0.1:{free_port()}"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

    def start(*arguments):
        command = [sys.executable, "-m", "dask", *arguments]
        quiet = subprocess.DEVNULL
        return subprocess.Popen(command, stdout=quiet, stderr=quiet, cwd=folder, env=environment)

    worker = ("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
    processes = [start("scheduler", "--port", address.rpartition(":")[2], "--no-dashboard")]
    processes += [start(*worker), start(*worker)]
    try:
        yield address, processes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()
