"""Pictures of the workbench before and after a click, and of a view: `python workbench_pictures.py RUNS M.toml OUT`.

RUNS is the folder of the imported UR5 recordings, M.toml the model as given, OUT where the pictures go.
"""

import subprocess
import sys
import time
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from browser import Browser

ARMDYN = [sys.executable, "-m", "pipeline.cli"]
EFFECT = "[data-every='joint_coulomb_friction']"
COLOURS = 160


def main(runs: Path, model: Path, out: Path) -> None:
    """Make them all."""
    fitted = [str(runs / name) for name in ("sweep_1.csv", "sweep_2.csv")]
    command = [*ARMDYN, "workbench", str(model), *fitted, "--held-out", str(runs / "pick_and_place.csv")]
    server = subprocess.Popen([*command, "--no-browser"], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = server.stdout.readline().split()[2].rstrip(",")
    try:
        workbench(address, out, "", 1400, 1000, dark=False)
        workbench(address, out, "_small", 400, 1500, dark=True)
    finally:
        server.terminate()
        server.wait()
    page = runs / "view.html"
    shown = [*ARMDYN, "view", "sweep_1.csv", "--robot", "ur5", "--output", page.name, "--force"]
    subprocess.run(shown, check=True, cwd=runs)  # as a user would, whose page tells the command
    view(page, out / "view.png", 1400, 900, dark=False)
    view(page, out / "view_small.png", 400, 700, dark=True)


def workbench(address: str, out: Path, suffix: str, width: int, height: int, *, dark: bool) -> None:
    """Before and after a click."""
    with Browser(width, height, dark=dark) as tab:
        tab.go(address)
        tab.wait("document.body.dataset.ready && document.querySelector('[data-pick]')")
        tab.click("#curves [data-tab='tau.shoulder_lift_joint'] + span")
        tab.click("#show-scene")
        tab.wait("document.getElementById('scene').dataset.ready")
        tab.ask("document.querySelector('#scene input').value = 420")
        tab.ask("document.querySelector('#scene input').dispatchEvent(new Event('input', { bubbles: true }))")
        keep(tab, out / f"workbench_before{suffix}.png")
        tab.click(EFFECT)
        tab.wait("armdynBench.latencies.length && document.querySelector('.how.fitted')")
        time.sleep(1.5)  # the refit begins when the clicks stop
        tab.wait("document.querySelector('.how.fitted') && document.querySelector('#busy').hidden")
        keep(tab, out / f"workbench_after{suffix}.png")


def view(page: Path, out: Path, width: int, height: int, *, dark: bool) -> None:
    """A moment of a recording."""
    with Browser(width, height, dark=dark) as tab:
        tab.go(f"{page.resolve().as_uri()}#time=6")
        tab.wait("document.body.dataset.ready")
        keep(tab, out)


def keep(tab: Browser, path: Path) -> None:
    """A picture from the top of the page, in few colours."""
    tab.ask("window.scrollTo({ top: 0, behavior: 'instant' })")
    tab.ask("document.activeElement?.blur()")
    tab.point(2, 2)
    time.sleep(0.5)
    tab.picture(path)
    Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
