"""The notebook runs from top to bottom, its cells show something, and the outputs that it holds are theirs."""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
from notebook_outputs import run_cell

EXAMPLES = Path(__file__).parents[2] / "examples"
NOTEBOOK = json.loads((EXAMPLES / "walk.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def words(text):
    """A text without its numbers, whose last digits depend on the machine."""
    return re.sub(r"[-−]?\d[\d.e+-]*", "#", text).split()


def test_the_notebook_walks_a_pendulum_and_an_arm(tmp_path, monkeypatch):
    pytest.importorskip("pandas", reason="the notebook needs pandas: pip install 'armdyn[notebook]'")
    for folder in ("pendulum", "ur5"):
        shutil.copytree(EXAMPLES / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    names = {}
    ran = [run_cell(source, names) for source in CODE]
    values = [value for _, value in ran if value is not None]
    rich = [value for value in values if hasattr(value, "_repr_html_") and len(value._repr_html_()) > 100]
    assert len(rich) >= 10  # runs, results, figures, tables
    assert [effect.name for effect in names["pendulum"].model.effects] == ["quadratic_drag"]
    assert names["pendulum"].model.value("quadratic_drag.coefficient") == pytest.approx(0.04, rel=0.05)
    assert names["robot"].model.value("payload.mass[wrist_3_joint]") == pytest.approx(1.5, abs=0.005)
    assert "<mujoco" in Path("ur5_repaired.xml").read_text()
    assert "pendulum, length 0.36 m, mass 0.08 kg; no effects" in ran[3][0]
    for (said, value), cell in zip(ran, (c for c in NOTEBOOK["cells"] if c["cell_type"] == "code"), strict=True):
        kept = {output["output_type"]: output for output in cell["outputs"]}
        assert words(said) == words("".join(kept.get("stream", {}).get("text", ())))
        assert (value is None) == ("display_data" not in kept)
        if value is not None and not hasattr(value, "to_plotly_json"):
            assert words(repr(value)) == words("".join(kept["display_data"]["data"]["text/plain"]))


def test_the_outputs_are_small():
    assert NOTEBOOK["nbformat"] == 4
    assert len(json.dumps(NOTEBOOK)) < 300_000
