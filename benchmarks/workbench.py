"""How long from a click to the new curve, for a 7-joint arm with two recordings of 30 s at 250 Hz?

    python benchmarks/workbench.py

In headless Chromium, with real clicks: an effect's box is pressed, and the clock stops when the curves with it are
drawn. Beside it stands what a click costs that changes nothing on the server: the same curves are drawn again.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import _timing as bench
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from browser import Browser
from worlds.baxter import JOINTS, generate

from armdyn.arm.model import arm_model
from armdyn.model_file import ModelFile, write_model_file
from armdyn.run import write_run_csv

EFFECTS = ("joint_viscous_friction", "joint_coulomb_friction", "torque_offset", "link_inertia")
PAUSE = 0.6  # s, in which the refit ends


def main() -> None:
    """Print median and largest duration."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in range(2):
            hidden = ["joint_viscous_friction", "payload"]
            write_run_csv(generate(hidden, 1.0, 0, recording=i, duration=30.0, rate=250.0), folder / f"{i}.csv")
        write_model_file(folder / "m.toml", ModelFile(arm_model(robot="baxter"), {"robot": "baxter"}))
        command = [sys.executable, "-m", "pipeline.cli", "workbench", "m.toml", "0.csv", "1.csv", "--no-browser"]
        server = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        address = server.stdout.readline().split()[2].rstrip(",")
        try:
            with Browser() as tab:
                measure(tab, address)
        finally:
            server.terminate()
            server.wait()


def measure(tab: Browser, address: str) -> None:
    """Open the page, click, and print the durations until the new curve."""
    print(f"processes that wait for one of {os.cpu_count()} cores: {os.getloadavg()[0]:.1f}")
    start = time.perf_counter()
    tab.go(address)
    tab.wait("document.querySelector('.bench h1')")
    print(f"first page                 {time.perf_counter() - start:6.2f} s")
    tab.wait("document.body.dataset.ready")
    print(f"curves of both recordings  {time.perf_counter() - start:6.2f} s")
    tab.wait("document.querySelector('[data-pick]')")
    print(f"effects can be ticked      {time.perf_counter() - start:6.2f} s")
    for effect in EFFECTS:
        for joint in JOINTS:
            n = tab.ask("armdynBench.latencies.length")
            tab.click(f"[data-pick='{effect}:{joint}'] + span")
            tab.wait(f"armdynBench.latencies.length > {n}")
            time.sleep(PAUSE)
    clicks, again = tab.ask("armdynBench.latencies"), [tab.ask(REDRAW) for _ in range(20)]
    rows = [
        [what, str(len(times)), f"{np.median(times):.0f}", f"{np.max(times):.0f}"]
        for what, times in (("click to new curve", clicks), ("the same curves again", again))
    ]
    bench.print_table("Time to drawn curves [ms]", ["what", "tries", "median", "worst"], rows)


REDRAW = """(async () => {
    const chart = document.querySelector("#curves .chart"), start = performance.now();
    await Plotly.react(chart, chart.data, chart.layout);
    return performance.now() - start;
})()"""


if __name__ == "__main__":
    main()
