"""The notebook runs from top to bottom, its cells show something, and it holds no outputs of an earlier run."""

import ast
import json
import shutil
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
NOTEBOOK = json.loads((EXAMPLES / "walk.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def shown(source, names):
    """Run a cell as a notebook does; the value of its last line, where that is an expression."""
    body = ast.parse(source).body
    last = ast.Expression(body.pop().value) if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return None if last is None else eval(compile(last, "cell", "eval"), names)


def test_the_notebook_walks_a_pendulum_and_an_arm(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas", reason="the notebook needs pandas: pip install 'armdyn[notebook]'")
    for folder in ("pendulum", "ur5"):
        shutil.copytree(EXAMPLES / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    names = {}
    values = [value for source in CODE if (value := shown(source, names)) is not None]
    rich = [value for value in values if hasattr(value, "_repr_html_") and len(value._repr_html_()) > 100]
    assert len(rich) >= 10  # runs, results, figures, tables
    assert [effect.name for effect in names["pendulum"].model.effects] == ["quadratic_drag"]
    assert names["pendulum"].model.value("quadratic_drag.coefficient") == pytest.approx(0.04, rel=0.05)
    assert names["robot"].model.value("payload.mass[wrist_3_joint]") == pytest.approx(1.5, abs=0.005)
    assert "<mujoco" in Path("ur5_repaired.xml").read_text()
    assert "pendulum, length 0.36 m, mass 0.08 kg; no effects" in capsys.readouterr().out


def test_the_notebook_is_kept_without_outputs():
    assert NOTEBOOK["nbformat"] == 4
    assert all(
        not cell["outputs"] and cell["execution_count"] is None for cell in NOTEBOOK["cells"] if "outputs" in cell
    )
