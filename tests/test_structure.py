"""The rules of docs/architecture.md that a machine can check."""

import ast
import re
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from armdyn.effects.catalogue import CATALOGUE

ROOT = Path(__file__).parents[1]
PACKAGES = ("pipeline", "ik", "armdyn", "urdf")  # each may import those after it
KIND_OF_MODEL = re.compile(
    r"isinstance\([^)]*(Arm|Pendulum|Physics|Simulated)Model\b|\.base (==|!=|in) |model\.linear\b"
)
MOST_KINDS, MOST_FILES, MOST_SHARED_NAMES = 5, 25, 10
MOST_EFFECTS_BY_NAME, MOST_SOLVES = 60, 5
"""Names of effects outside their own folder, and solutions of linear systems outside the kernel."""
"""Questions after the kind of a model, files of a folder, public classes whose name another one has."""

FILES = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py")) if file.is_file()]


def imported(file):
    """Top packages of this project that a file imports."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        yield from {name.partition(".")[0] for name in names} & {*PACKAGES}


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_point_one_way(package):
    behind = PACKAGES[PACKAGES.index(package) :]
    wrong = [f"{f.relative_to(ROOT)}: {to}" for f in FILES if f.relative_to(ROOT).parts[0] == package
             for to in imported(f) if to not in behind]  # fmt: skip
    assert not wrong


def test_a_model_answers_instead_of_being_asked_what_it_is():
    lines = [(f, line) for f in FILES if f.name != "model_file.py" for line in f.read_text("utf-8").splitlines()]
    found = [f"{f.relative_to(ROOT)}: {line.strip()}" for f, line in lines if KIND_OF_MODEL.search(line)]
    assert len(found) <= MOST_KINDS, found


def test_no_folder_is_full():
    full = {str(folder): n for folder, n in Counter(file.parent for file in FILES).items() if n > MOST_FILES}
    assert not full


def test_a_public_class_has_a_name_of_its_own():
    classes = [node.name for file in FILES for node in ast.parse(file.read_text(encoding="utf-8")).body
               if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]  # fmt: skip
    shared = {name: n for name, n in Counter(classes).items() if n > 1}
    assert len(shared) <= MOST_SHARED_NAMES, shared


def module_of(file):
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def test_no_files_import_one_another_in_a_circle():
    """Imports for type checking count, and those within functions."""
    known, arrows = {module_of(file) for file in FILES}, {}
    for file in FILES:
        nodes = [*ast.walk(ast.parse(file.read_text(encoding="utf-8")))]
        names = {a.name for node in nodes if isinstance(node, ast.Import) for a in node.names}
        for node in (node for node in nodes if isinstance(node, ast.ImportFrom) and node.module):
            inner = {f"{node.module}.{a.name}" for a in node.names}
            names |= inner & known or {node.module}
        arrows[module_of(file)] = (names & known) - {module_of(file)}
    TopologicalSorter(arrows).prepare()  # raises an error with the circle


def test_effects_are_seldom_called_by_name():
    """Outside their own folder, the table of what is plausible and the simulated robot."""
    quoted = re.compile(rf"""["'`]({"|".join(CATALOGUE)})[."':`\[]""")
    apart = ("armdyn/effects/", "armdyn/inspection/plausible.py", "pipeline/robot/")
    found = Counter({
        file.relative_to(ROOT).as_posix(): len(quoted.findall(file.read_text(encoding="utf-8")))
        for file in FILES if not file.relative_to(ROOT).as_posix().startswith(apart)
    })  # fmt: skip
    assert found.total() <= MOST_EFFECTS_BY_NAME, found.most_common(5)


WRITES_ITSELF = {
    "armdyn/atomic.py",
    "pipeline/console/screen.py",  # the null device, for a reader that ended early
    "pipeline/console/streams.py",  # the same, and the report of an error of armdyn's own
    "pipeline/trial/folder.py",  # the lock
}


WRITING_MODE = re.compile(r"[wax][bt]?\+?[bt]?|r[bt]?\+[bt]?")


def writes(call):
    """Whether a call may write to a file without `armdyn.atomic`."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    of = call.func.value.id if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name) else ""
    modes = {part.value for part in [*call.args[:2], *(k.value for k in call.keywords if k.arg == "mode")]
             if isinstance(part, ast.Constant) and isinstance(part.value, str)}  # fmt: skip
    return (
        (name in ("write_text", "write_bytes") and of not in ("atomic", ""))
        or (name in ("open", "fdopen") and any(map(WRITING_MODE.fullmatch, modes)))
        or (of == "os" and name == "open")
        or (of == "shutil" and name in ("copy", "copy2", "copyfile", "move"))
        or name == "NamedTemporaryFile"
    )  # fmt: skip


def test_files_are_written_by_one_module():
    """What writes a file by itself may overwrite an input, or leave half a file on a full disk."""
    found = {
        file.relative_to(ROOT).as_posix() for file in FILES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Call) and writes(node)
    }  # fmt: skip
    assert found == WRITES_ITSELF


def test_linear_systems_are_solved_in_the_kernel():
    """Elsewhere only where a robot's own mechanics or a sensor's smoothing needs a decomposition."""
    solve = re.compile(r"linalg\.(solve|inv|pinv|lstsq|cholesky)\(|cho_(solve|factor)\(|solve_(triangular|banded)\(")
    apart = (
        "armdyn/estimation/",
        "armdyn/smoothing/",
        "armdyn/physics/",
        "armdyn/pendulum/",
        "armdyn/control/",
        "ik/",
        "armdyn/arm/rigid.py",
        "armdyn/arm/closed_loop/motion_slopes.py",
        "armdyn/readout.py",
    )
    found = Counter({
        file.relative_to(ROOT).as_posix(): len(solve.findall(file.read_text(encoding="utf-8")))
        for file in FILES if file.is_relative_to(ROOT / "armdyn")
        and not file.relative_to(ROOT).as_posix().startswith(apart)
    })  # fmt: skip
    assert found.total() <= MOST_SOLVES, found.most_common(10)


SOLVES_IN_ROUNDS = {
    "armdyn/arm/drive.py": "frictions that follow the load of the regression before",
    "armdyn/identify/selection/sums.py": "latent unknowns of a linearisation, in proportion to their driver",
    "armdyn/identify/state_space/grey_run.py": "pieces that are divided",
    "armdyn/inspection/arm.py": "weights from the residual of the round before",
    "armdyn/inspection/evidence.py": "sizes and noise of most evidence",
    "armdyn/watch/onset.py": "weights from the residual of the round before",
    "armdyn/watch/variances.py": "weights from the variances of the round before",
}
"""Files with a loop of their own that solves a system in each round, and what changes from round to round."""
OPTIMISES = {
    "armdyn/arm/drive_gain/drive_scale.py": "one value: a delay or a saturating error",
    "armdyn/experiments/search.py": "motions within limits",
    "armdyn/inspection/physics.py": "the clock of a channel, by evidence without derivatives",
    "pipeline/imports/pendulum.py": "the circle of a load in a video",
}
"""Files that use a minimiser of scipy, and what for."""
NO_STATISTICS = ("armdyn/estimation/", "armdyn/physics/", "armdyn/arm/memory.py", "armdyn/pendulum/", "armdyn/control/")
"""Where a loop is the kernel's own, or integrates equations of motion."""


SOLVERS = {
    "solve_bounded", "solve_positive", "least_squares", "inverse_positive", "pseudo_inverse", "pseudo_inverses",
    "solve", "lstsq",
}  # fmt: skip


def solves(node):
    """Whether a loop over a number of rounds, or until something happens, contains a solution of a linear system."""
    over = node.iter.func if isinstance(node, ast.For) and isinstance(node.iter, ast.Call) else None
    calls = (call.func for call in ast.walk(node) if isinstance(call, ast.Call))
    names = {getattr(called, "attr", getattr(called, "id", "")) for called in calls}
    return (getattr(over, "id", "") == "range" or isinstance(node, ast.While)) and not names.isdisjoint(SOLVERS)


def test_nonlinear_fits_descend_by_the_kernels_loop():
    """A new fit is a `Cost` of `armdyn.estimation.descent`, not a loop of its own beside it."""
    names = [(file, file.relative_to(ROOT).as_posix()) for file in FILES]
    loops = {name for file, name in names if name.startswith("armdyn/") and not name.startswith(NO_STATISTICS)
             and any(map(solves, ast.walk(ast.parse(file.read_text(encoding="utf-8")))))}  # fmt: skip
    minimiser = re.compile(r"^from scipy.optimize import .*(minimize|least_squares)", re.MULTILINE)
    assert loops == SOLVES_IN_ROUNDS.keys()
    assert {name for file, name in names if minimiser.search(file.read_text(encoding="utf-8"))} == OPTIMISES.keys()
