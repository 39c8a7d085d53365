"""The commands that the pages show, run as they stand: what they print, and the pictures of what they write.

`python docs/pages.py [PAGE...]` brings numbers and pictures up to date; `tests/docs/test_pages.py` compares them. A
block ```console has commands behind `$`, and of what a command prints the lines that matter, in their order: whole, or
parts of them between `...`. Where words differ, the page is to be written anew, which no script can do.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\w)")
OTHERWISE = 0.02
"""Relative difference of a number on another processor, whose roundings a simulated robot in a loop carries on."""
NOT_RUN = ("pip ", "armdyn workbench ")
"""How commands begin that end nowhere, or in another environment."""

HOBBY_ARM = """PYTHONPATH=ROOT/tests:ROOT python - <<'EOF'
from pathlib import Path
from worlds.hobby_arm import write
write(Path("."))
EOF"""
UR5 = (
    "armdyn import ROOT/examples/ur5/*.csv --output . --guess --robot ur5",
    "armdyn import ROOT/examples/ur5/*.csv --output . --map map.toml",
    "armdyn new arm ur5.toml --robot ur5",
)
MISTAKEN = """python - <<'EOF'
import csv
head, *rows = csv.reader(open("sweep_1.csv"))
a, b = (head.index(f"tau.{joint} [N m]") for joint in ("shoulder_lift_joint", "elbow_joint"))
for row in rows:
    row[a], row[b] = row[b], row[a]
    row[1:] = row[1:] if not 6.0 < float(row[0]) < 7.2 else [""] * (len(row) - 1)
csv.writer(open("sweep_3.csv", "w")).writerows([head, *rows])
EOF"""
"""Two columns are exchanged and 1.2 s lost."""
LAB = """PYTHONPATH=ROOT/tests python - <<'EOF'
from pathlib import Path
from worlds.lab import Change, Lab
changes = {1: Change(19, tool=0.1), 4: Change(12, dry_friction=1.25)}
Lab(robots=6, recordings=36, changes=changes).write(Path("robots"))
Path("lab.toml").write_text('''task = "compare"
[[recordings]]
model = "robots/{robot}/model.toml"
runs = ["robots/{robot}/logs/*.csv"]
''')
EOF"""
TANKS = """python - <<'EOF'
import numpy as np
from scipy.integrate import solve_ivp
time = np.arange(0.0, 2400.0, 2.0)
for day in (1, 2, 3):
    rng = np.random.default_rng(day)
    paces, phases = 0.025 * np.array([0.45, 1.0, 2.2]), rng.uniform(0.0, 6.0, 3)
    pump = lambda t: 3.2 + 0.9 * np.sin(np.multiply.outer(t, paces) + phases).sum(axis=-1)
    def rates(t, levels):
        upper, lower = np.maximum(levels, 0.0)
        out, back = 0.09 * np.sqrt(upper), 0.075 * np.sqrt(lower)
        return 0.055 * pump(t) - out - 0.15 * max(upper - 6.7, 0.0), out - back
    level = solve_ivp(rates, (0.0, 2400.0), (5.0, 5.0), t_eval=time, max_step=1.0).y[1] + 0.03 * rng.normal(size=1200)
    table = np.column_stack([time, pump(time), level])
    head = "time [s],extra.pump [V],extra.level [V]"
    np.savetxt(f"day_{day}.csv", table, "%.5f", ",", header=head, comments="")
EOF"""
"""Three days of two tanks, of which the upper one overflows at 6.7 V."""
VIDEO = """python - <<'EOF'
import numpy as np
from scipy.integrate import solve_ivp
time, rng = np.arange(0.0, 60.0, 1 / 30), np.random.default_rng(1)
for day, angle in ((1, 0.7), (2, 0.35)):
    def rates(t, y):
        return [y[1], -9.81 / 0.655 * np.sin(y[0]) - 0.015 * y[1] * abs(y[1]) - 0.004 * y[1]]
    swing = solve_ivp(rates, (0.0, 60.0), (angle, 0.0), t_eval=time, rtol=1e-9).y[0]
    x, y = 640.0 - 420.0 * np.sin(swing), 100.0 + 420.0 * np.cos(swing)
    table = np.column_stack([time, x + 0.4 * rng.normal(size=len(time)), y + 0.4 * rng.normal(size=len(time))])
    np.savetxt(f"video_{day}.csv", table, "%.4f", ",", header="t,x,y", comments="")
EOF"""
"""A tracker's places of a cup on a string, in pixels, y down: drag of 0.015 1/rad and friction of 0.004 1/s."""
PAGES = {
    "README.md": (
        "cp ROOT/examples/ur5/sweep_1.csv log.csv", "armdyn trial --picture",
        """cp "$(python -W ignore -c 'import urdf; print(urdf.load("ur5").urdf_path)')" robot.urdf""",
    ),
    "docs/your_robot.md": ("cp -r ROOT/examples .",),
    "docs/pendulum.md": (VIDEO,),
    "docs/inspect.md": (*UR5, MISTAKEN),
    "docs/your_own_base.md": ("cp ROOT/examples/tanks.py .", TANKS),
    "docs/servo_arm.md": (HOBBY_ARM,),
    "docs/batch.md": (LAB,),
    "docs/discover.md": (
        "cp ROOT/examples/pendulum/* ROOT/examples/*.py .",
        "cp magnet_1.csv swing_1.csv", "cp magnet_2.csv swing_2.csv",
        "armdyn new pendulum model.toml --set mass='80 g' --set length='0.36 m'",
    ),
    "docs/workbench.md": (
        *UR5, "cp ROOT/examples/pendulum/swing_1.csv swing.csv", "cp ROOT/examples/pendulum/swing_1.toml swing.toml",
        "armdyn new pendulum repaired.toml", "armdyn trial", "armdyn ik build --out line.npz",
        """python -c 'import math
print("time [s],s [m]", *(f"{k / 100},{0.2 * math.sin(k / 12.5)}" for k in range(300)), sep=chr(10))' > motion.csv""",
    ),
}  # fmt: skip
"""Pages with console blocks, and what makes the files that they speak of; ROOT is this repository."""


@dataclass(frozen=True)
class Picture:
    """One that a page shows, of what its commands before it wrote.

    Attributes:
        page: that makes it.
        source: picture that is copied, or page that is opened, in the page's folder.
        height: of the part of the page that is shown, px.
        part: of an address, behind its `#`.
    """

    page: str
    source: str
    height: int = 0
    part: str = ""

    def make(self, folder: Path, out: Path) -> None:
        """Write it to a file."""
        source = (folder / self.source).resolve()
        if not self.height:
            shutil.copy(source, out)
            return
        from browser import Browser

        with Browser(WIDTH, self.height) as tab:
            tab.go(f"{source.as_uri()}#{self.part}")
            tab.wait("document.body.dataset.ready")
            time.sleep(SETTLED)
            tab.picture(out)


WIDTH, SETTLED = 1280, 2.0
"""px; s after which figures stand still."""
PICTURES = {
    "swing.gif": Picture("README.md", "out/trial/swing.gif"),
    "trial_report.png": Picture("README.md", "out/trial/report.html", 1560),
    "swing_missed.png": Picture("README.md", "out/trial/swing.png"),
    "repair_report.png": Picture("README.md", "repair.html", 1500),
    "swing_repaired.png": Picture("README.md", "out/trial/swing.png"),
    "investigation.png": Picture("README.md", "out/trial/report.html", 910, "what-the-model-lacked"),
    "arm_report.png": Picture("docs/your_robot.md", "repair.html", 1330, "the-missing-force"),
    "servo_report.png": Picture("docs/servo_arm.md", "repair.html", 870, "motion"),
    "inspect_report.png": Picture("docs/inspect.md", "inspect.html", 1250),
    "batch_report.png": Picture("docs/batch.md", "lab/report.html", 1560),
}
"""By their names; those of the workbench, which is clicked at, are made by `workbench_pictures.py`."""


@dataclass(frozen=True)
class Displayable:
    """A command of a page, and the lines of what it prints that the page has, from `start` on [line of the page]."""

    start: int
    command: str
    lines: tuple[str, ...]


def parts_of(page: str) -> Iterator[Displayable | str]:
    """Commands of a page's console blocks and names of pictures that it makes, in their order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for found in re.finditer(r"^```console\n(.*?)^```$|pictures/([\w.]+)\)", text, re.MULTILINE | re.DOTALL):
        if found[2]:
            if found[2] in PICTURES and PICTURES[found[2]].page == page:
                yield found[2]
            continue
        start = text[: found.start()].count("\n") + 1
        for part in re.split(r"^(?=\$ )", found[1], flags=re.MULTILINE)[1:]:
            command, *lines = part.splitlines()
            yield Displayable(start + 1, command.removeprefix("$ ").split("  #")[0].strip(), tuple(lines))
            start += len(lines) + 1


def printed(command: str, folder: Path) -> str:
    """What a command prints, white space as one space each.

    Raises:
        AssertionError: it could not be done.
    """
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    settings = {"PATH": path, "COLUMNS": "120", "XDG_CONFIG_HOME": str(folder / "settings")}
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command.replace("ROOT", str(ROOT))], cwd=folder, env=os.environ | settings,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert done.returncode in (0, 1), f"{command}: {done.stdout}"
    return " ".join(done.stdout.split())


def up_to_date(shown: Displayable, said: str) -> list[str]:
    """The lines that a page shows of a command, with the numbers of what it printed.

    Raises:
        AssertionError: it has not printed them.
    """
    found, at = [], 0
    for number, line in enumerate(shown.lines):
        pieces = re.split(r"(\s*\[?\.\.\.\]?\s*)", line)
        for i in range(0, len(pieces), 2):
            words = NUMBER.split(pieces[i])
            pattern = f"({NUMBER.pattern})".join(re.sub(r"(\\ )+", r"\\s+", re.escape(word)) for word in words)
            matches = list(re.compile(pattern.removeprefix(r"\s+").removesuffix(r"\s+")).finditer(said, at))
            assert matches, f"line {shown.start + number + 1}: not printed: {pieces[i]!r}\n{said}"
            kept = NUMBER.findall(pieces[i])
            match = next((m for m in matches if near(kept, m.groups())), matches[0])
            at = match.end()
            if not near(kept, match.groups()):
                pieces[i] = "".join(a + b for a, b in zip(words, (*match.groups(), ""), strict=True))
        found.append("".join(pieces))
    return found


def near(kept: Sequence[str], found: Sequence[str]) -> bool:
    """Whether numbers are those of the page, as far as roundings allow."""
    return all(abs(float(a) - float(b)) <= room(a) for a, b in zip(kept, found, strict=True))


def room(number: str) -> float:
    """What a number may differ by: `OTHERWISE`, and one of its last digit."""
    digits = number.partition("e")[0].partition(".")[2]
    exponent = int(number.partition("e")[2] or 0)
    return 1.001 * max(OTHERWISE * abs(float(number)), 10.0 ** (exponent - len(digits)))


def run(page: str, folder: Path, pictures: Path) -> Iterator[tuple[Displayable, list[str]]]:
    """Run a page in an empty folder, with its pictures into another; its commands and their lines as they are now."""
    for command in PAGES[page]:
        printed(command, folder)
    for part in parts_of(page):
        if isinstance(part, str):
            PICTURES[part].make(folder, pictures / part)
        elif not part.command.startswith(NOT_RUN):
            yield part, up_to_date(part, printed(part.command, folder))
    if page == "docs/workbench.md":
        import workbench_pictures

        workbench_pictures.main(folder, folder / "ur5.toml", pictures)


def difference(kept: Path, made: Path) -> float:
    """Between two pictures, root mean square of grey from 0 to 1 of their `SEEN` parts; 1 where the sizes differ."""
    greys = []
    for path in (kept, made):
        with Image.open(path) as picture:
            picture.seek(getattr(picture, "n_frames", 1) // 2)
            greys.append((picture.size, np.asarray(picture.convert("L").resize(SEEN, Image.Resampling.BOX)) / 255.0))
    (size, grey), (other_size, other) = greys
    return float(np.sqrt(np.mean((grey - other) ** 2))) if size == other_size else 1.0


SEEN, ANOTHER = (64, 48), 0.02
"""Parts of a picture, across and down; difference from which on it shows something else."""


def main(pages: Sequence[str]) -> None:
    """Bring pages up to date, and the pictures that show something else than before."""
    for page in pages:
        lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
        with tempfile.TemporaryDirectory() as name:
            folder, pictures = Path(name) / "work", Path(name) / "pictures"
            folder.mkdir()
            pictures.mkdir()
            for shown, now in run(page, folder, pictures):
                print(f"{page}:{shown.start}: {shown.command}", flush=True)
                lines[shown.start : shown.start + len(now)] = now
            for made in sorted(pictures.iterdir()):
                kept = ROOT / "docs/pictures" / made.name
                changed = difference(kept, made) if kept.exists() else 1.0
                print(f"{made.name}: differs by {changed:.4f}")
                if changed > ANOTHER:
                    shutil.copy(made, kept)
        (ROOT / page).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] or list(PAGES))
