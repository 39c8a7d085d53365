"""What every command answers on small recordings, as kept in the files beside this one: status, screen and JSON.

Processors round otherwise. So a number is compared as well as it is determined: a value within the standard
deviation that stands beside it, of an optimum what was reached and not where it is, the others to `DIGITS`.

`GOLDEN=write pytest tests/golden` writes those anew that are not alike; read the difference before you keep it.
"""

import json
import math
import os
import re
import shlex
import shutil
from pathlib import Path

import messages
import numpy as np
import pytest
from command import called

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
WRITE = os.environ.get("GOLDEN") == "write"
DIGITS = 3e-3
"""Relative, where nothing says how well a number is determined."""
WITHIN = {
    "value": ("std", 0.1), "as_given": ("std", 0.1), "repaired": ("std", 0.1),
    "length_estimate": ("length_std", 3.0), "mean": ("std", 3.0),
}  # fmt: skip
"""Whose standard deviation stands beside it, and how many it may differ by: a fit to the same samples by few hundredths
where processors round otherwise, an estimate from other samples, which a robot in a loop makes, by three."""
REACHED = ("separation", "random")
"""What an optimiser made large, the second over that of random motions: it may be larger."""
LESS = 0.03
"""Share by which it may be smaller: from the same starts, two kinds of processor reach ends that differ by 0.012."""
END_POINT = ("unknowns", "separations", "condition_number", "peaks", "peak", "effort", "energy")
"""Where an optimiser ended: names and units are compared, no numbers."""
IN_A_LOOP = ("trial", "table")
"""Commands that move a robot by what it measures: every rounding ends in another motion, as of an optimiser."""
LONGEST = 4
"""Entries of a list that are kept; of a longer one its ends, and of numbers their size."""
LOADED = re.compile(r"""<[^>]*\b(src|href)\s*=\s*["']?(https?:|//)|<script[^>]*\ssrc""")
"""Something that a page would load from elsewhere."""
OF_THE_CLOCK = ("seconds", "targets_per_second", "version", "estimation_cycle")

CASES = {
    "new_pendulum": ["new pendulum M.toml --set length='0.37 m' --set mass='80 g +/- 0.4 g' --json J"],
    "new_arm": ["new arm A.toml --robot ur5 --json J"],
    "new_own_base": ["new --base crane.py C.toml --json J"],
    "effects": ["effects --json J"],
    "compare": ["compare pendulum.toml swing_1.csv swing_2.csv --report R --json J"],
    "compare_held_out": ["compare pendulum.toml swing_1.csv --held-out swing_2.csv --exam magnet_1.csv --json J"],
    "compare_arm": ["compare ur5.toml ur5/sweep_1.csv --report R --json J"],
    "diagnose": ["diagnose pendulum.toml swing_1.csv swing_2.csv --report R --json J"],
    "diagnose_unknown": ["diagnose pendulum.toml magnet_1.csv magnet_2.csv --report R --json J"],
    "repair": ["repair pendulum.toml swing_1.csv --held-out swing_2.csv --output M.toml --report R --json J"],
    "repair_arm": ["repair ur5.toml ur5/sweep_1.csv --held-out ur5/sweep_2.csv --output M.toml --report R --json J"],
    "add_and_export": [
        "add pendulum.toml quadratic_drag swing_1.csv swing_2.csv --output M.toml --report R --json J",
        "export M.toml --output model.json --json J",
        "export M.toml --output model.py --json J",
        "export M.toml --output model.urdf --json J",
    ],
    "add_and_export_arm": [
        "add ur5.toml joint_viscous_friction ur5/sweep_1.csv --output M.toml --report R --json J",
        "export M.toml --output model.urdf --json J",
        "export M.toml --output model.xml --incomplete --json J",
    ],
    "next": [
        "next pendulum.toml swing_1.csv --rivals linear_drag,quadratic_drag --seconds 5 --output motion.csv"
        " --report R --json J",
    ],
    "excite": ["excite --robot ur5 --for joint_viscous_friction --seconds 5 --random 3 --output q.csv --report R"
        " --json J"],
    "excite_rivals": [
        "excite --robot ur5 --rivals joint_viscous_friction,joint_coulomb_friction --seconds 4 --random 3 --no-compare"
        " --output q.csv --report R --json J"
    ],
    "check_refuses": ["check wild.csv --report R --json J"],
    "check_arm": ["check ur5/sweep_1.csv --robot ur5 --json J"],
    "inspect": ["inspect pendulum.toml swing_1.csv --report R --json J"],
    "inspect_degrees": ["inspect pendulum.toml degrees.csv --report R --fix fixed --json J",
        "compare pendulum.toml degrees.csv --json J"],
    "import": [
        "import foreign.csv --output runs --guess --json J",
        "import foreign.csv --output runs --map runs/map.toml --json J",
    ],
    "ik": [
        "ik build --out table.npz --json J", "ik show table.npz --report R --json J",
        "ik look table.npz --at 0,0.1 --speed 0.2 --json J",
    ],
    "arm": ["arm show --robot ur5 --velocity 0.1,0,0,0,0,0 --json J"],
    "view": ["view swing_1.csv --model pendulum.toml --output view.html --json J"],
    "batch": ["batch spec.toml --output out --workers 1 --json J"],
    "trial": ["trial --seed 1 --out out --json J"],
    "trial_investigate": ["trial --hidden pivot_viscous_friction --seed 2 --investigate 1 --out out --json J"],
    "table": ["table --seeds 1 --out out --json J"],
    "bad_input": [
        "compare absent.toml swing_1.csv --json J", "trial --hidden no_such_effect --json J",
        "check absent.csv --json J",
        "ik show absent.npz", "excite --robot ur5 --urdf a.urdf --output q.csv", "import absent.csv --output runs",
        "export pendulum.toml --output model.txt", "next pendulum.toml swing_1.csv --seconds 0", "view absent.csv",
        "batch absent.toml --output out", "arm show --at 1,2,x", "add pendulum.toml no_such_effect swing_1.csv",
        "record --ros ws://127.0.0.1:1 --output a.csv --seconds 0.2", "loadcell monitor /dev/absent",
        "inspect absent.csv",
        "new pendulum M.toml --set length", "table --seeds 0", "trial --robot ros", "workbench absent.toml",
        "trial --length-guess 0", "trial --length-guess -0.3", "trial --length-guess 10", "trial --length-guess nan",
        "trial --length-guess half", "trial --hidden quadratic_drg", "trial --hidden wind=strong",
        "trial --hidden wind --hidden wind=0.1", "trial --model absent.toml", "trial --seed -1", "trial --colour",
        "trail", "next pendulum.toml swing_1.csv --rivals nonsense", "next pendulum.toml swing_1.csv --seconds 0.5",
        "next pendulum.toml swing_1.csv --output no/such/folder/motion.csv", "new arm A.toml",
        "new arm A.toml --urdf a.urdf --mjcf b.xml", "new arm A.toml --robot ur5 --mjcf b.xml",
        "export pendulum.toml --output model.xml", "export pendulum.toml --output model.stl",
        "export pendulum.toml --output pendulum.toml --force", "import foreign.csv --output runs",
        "compare pendulum.toml foreign.csv", "view swing_1.csv --robot ur5 --urdf a.urdf",
    ],
}  # fmt: skip
SLOW = {"table", "diagnose", "repair_arm", "trial_investigate", "excite_rivals"}


@pytest.fixture(scope="session")
def recordings(tmp_path_factory):
    """The examples' recordings, models of them, and files that something is wrong with."""
    folder = tmp_path_factory.mktemp("golden")
    for file in (*EXAMPLES.glob("pendulum/*.*"), *EXAMPLES.glob("ur5/sweep_*"), EXAMPLES / "crane.py"):
        shutil.copy(file, folder)
    (folder / "pendulum.toml").write_text(
        'base = "pendulum"\n[parameters]\nlength = { value = 0.36, unit = "m" }\nmass = { value = 0.08, unit = "kg" }\n'
    )
    time = 0.01 * np.arange(300)
    wild = np.column_stack([time, 0.2 * np.sin(8.0 * time)])
    np.savetxt(folder / "wild.csv", wild, "%.6f", ",", header="time [s],s [m]", comments="")
    swing = 20.0 * np.cos(5.16 * time) * np.exp(-0.02 * time)
    degrees = np.column_stack([time, 0.0 * time, swing])
    np.savetxt(
        folder / "degrees.csv", degrees, "%.6f", ",", header="time [s],gripper_x [m],swing_angle [rad]", comments=""
    )
    q = np.sin(time)
    foreign = np.column_stack([time, np.degrees(q), np.degrees(np.cos(time)), 3.0 * q])
    names = "t,joint_1_pos,joint_1_vel,joint_1_torque"
    np.savetxt(folder / "foreign.csv", foreign, "%.6f", ",", header=names, comments="")
    (folder / "spec.toml").write_text(
        'task = "compare"\n[[recordings]]\nmodel = "pendulum.toml"\nruns = ["swing_*.csv", "magnet_1.csv"]\n'
    )
    here = Path.cwd()
    os.chdir(folder)
    try:
        for line in (
            "import sweep_1.csv sweep_2.csv --output ur5 --guess --robot ur5",
            "import sweep_1.csv sweep_2.csv --output ur5 --map ur5/map.toml",
            "new arm ur5.toml --robot ur5",
        ):
            assert called(*shlex.split(line))[0] == 0, line
    finally:
        os.chdir(here)
    return folder


def worded(text):
    """Lines of a screen without numbers and without the width of its columns."""
    numbers = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
    lines = (re.sub(r"\s+", " ", numbers.sub("#", line)).strip() for line in text.splitlines())
    return [line.replace("-#", "#") for line in lines if line]


def condensed(value, key=""):
    """An answer as it is kept: long lists as their ends, of what a clock said only that it is there."""
    if isinstance(value, dict):
        return {name: "..." if name in OF_THE_CLOCK else condensed(entry, name) for name, entry in value.items()}
    if not isinstance(value, list) or len(value) <= LONGEST:
        return [condensed(entry, key) for entry in value] if isinstance(value, list) else value
    numbers = [entry for entry in value if isinstance(entry, int | float)]
    about = {"length": len(value), "first": condensed(value[0]), "last": condensed(value[-1])}
    return about | ({"rms": math.sqrt(sum(n * n for n in numbers) / len(numbers))} if numbers else {})


def times(factor, std):
    """Standard deviations of one number, of a list, or of its ends and its size."""
    if isinstance(std, dict):
        return {name: factor * entry for name, entry in std.items()}
    return [factor * entry for entry in std] if isinstance(std, list) else factor * std


def assert_alike(found, kept, where="", room=0.0, reached=False):
    """Equal as far as rounding allows; numbers in sentences are not compared, as they stand beside them.

    `room` is what a number may differ by, infinite at an end point; `reached` is one that may be larger.
    """
    if isinstance(kept, dict) and isinstance(found, dict):
        assert list(found) == list(kept), where
        for name in kept:
            own = math.inf if name in END_POINT else room.get(name, 0.0) if isinstance(room, dict) else room
            if name in WITHIN and kept.get(WITHIN[name][0]):
                own = times(WITHIN[name][1], kept[WITHIN[name][0]])
            assert_alike(found[name], kept[name], f"{where}.{name}", own, reached or name in REACHED)
    elif isinstance(kept, list) and isinstance(found, list):
        assert len(found) == len(kept), where
        for i, entry in enumerate(kept):
            assert_alike(found[i], entry, f"{where}[{i}]", room[i] if isinstance(room, list) else room, reached)
    elif isinstance(kept, float) and isinstance(found, int | float):
        least = max((LESS if reached else DIGITS) * abs(kept), room, 1e-9)
        alike = abs(found - kept) <= least or (reached and found > kept)
        assert alike, f"{where}: {found}, kept {kept} +- {least:.2g}"
    elif isinstance(kept, str) and isinstance(found, str):
        assert worded(found) == worded(kept), where
    else:
        assert found == kept, where


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in CASES])
def test_a_command_answers_as_it_did(name, recordings, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    shutil.copytree(recordings, tmp_path, dirs_exist_ok=True)
    found = []
    for line in CASES[name]:
        Path("J.json").unlink(missing_ok=True)
        words = line.replace("--json J", "--json J.json").replace("--report R", "--report R.html")
        status, out, err = called(*shlex.split(words))
        here = str(tmp_path)
        answer = json.loads(Path("J.json").read_text().replace(here, "HERE")) if Path("J.json").is_file() else None
        screen = [*worded(out.replace(here, "HERE")), *worded(err.replace(here, "HERE"))]
        found.append({"command": line, "status": status, "screen": screen, "answer": condensed(answer)})
        for page in tmp_path.rglob("*.html"):
            assert not LOADED.search(page.read_text()), f"{page.name} of {line} is not one offline page"
        if "GOLDEN_PAGES" in os.environ:
            for page in tmp_path.rglob("*.html"):
                shutil.copy(page, Path(os.environ["GOLDEN_PAGES"]) / f"{name}.{len(found)}.{page.name}")
    if name == "bad_input":
        assert {(answer["status"], len(answer["screen"])) for answer in found} == {(2, 1)}
        assert not list(tmp_path.rglob("*.html"))
    file = HERE / f"{name}.json"
    kept = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
    try:
        assert len(found) == len(kept)
        for before, now in zip(kept, found, strict=True):
            loop = now["command"].split()[0] in IN_A_LOOP
            assert_alike(now, before, now["command"], math.inf if loop else 0.0)
    except AssertionError:
        if not WRITE:
            raise
        file.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def test_every_kept_message_belongs_to_a_test():
    tests = {key.partition("[")[0].partition(" (")[0] for key in messages.kept()}
    for file, _, name in (test.partition("::") for test in tests):
        assert f"def {name}(" in (HERE.parent / file).read_text(encoding="utf-8"), f"{file}: {name}"
