"""Run `examples/walk.ipynb` and keep what its cells show, figures as pictures, to be read where nothing runs.

`python docs/notebook_outputs.py`; it needs Chromium. `tests/examples/test_notebook.py` compares the texts.
"""

import ast
import base64
import contextlib
import io
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / "examples/walk.ipynb"
FIGURE = (900, 520)
"""Size of a figure in pixels."""
COLOURS = 64


def run_cell(source: str, names: dict[str, Any]) -> tuple[str, Any]:
    """What a cell prints, and the value of its last line where that is an expression, else None."""
    body = ast.parse(source).body
    last = ast.Expression(body.pop().value) if isinstance(body[-1], ast.Expr) else None
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        value = None if last is None else eval(compile(last, "cell", "eval"), names)
    return said.getvalue(), value


def picture(figure: Any) -> str:
    """A plotly figure as PNG in few colours, in base64."""
    with tempfile.TemporaryDirectory() as folder:
        page, png = Path(folder) / "page.html", Path(folder) / "figure.png"
        figure.update_layout(width=FIGURE[0], height=FIGURE[1])
        html = figure.to_html(include_plotlyjs=True, config={"staticPlot": True})
        page.write_text(html.replace("<body>", "<body style='margin: 0'>"), encoding="utf-8")
        subprocess.run(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--window-size={FIGURE[0]},{FIGURE[1]}", "--virtual-time-budget=8000", f"--screenshot={png}",
             page.as_uri()],
            check=True, capture_output=True,
        )  # fmt: skip
        Image.open(png).convert("RGB").quantize(COLOURS).save(png, optimize=True)
        return base64.b64encode(png.read_bytes()).decode()


def shown(value: Any) -> dict[str, Any]:
    """MIME bundle of a value: a picture of a figure, else text and HTML."""
    if hasattr(value, "to_plotly_json"):
        return {"image/png": picture(value), "text/plain": ["a plotly figure"]}
    bundle = {"text/plain": repr(value).splitlines(keepends=True)}
    html = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return bundle if html is None else {**bundle, "text/html": html.splitlines(keepends=True)}


def main() -> None:
    """Write the outputs of all cells."""
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for data in ("pendulum", "ur5"):
            shutil.copytree(NOTEBOOK.parent / data, Path(folder) / data)
        os.chdir(folder)
        for cell in (cell for cell in notebook["cells"] if cell["cell_type"] == "code"):
            said, value = run_cell("".join(cell["source"]), names)
            cell["outputs"] = []
            if said:
                cell["outputs"].append(
                    {"name": "stdout", "output_type": "stream", "text": said.splitlines(keepends=True)}
                )
            if value is not None:
                cell["outputs"].append({"output_type": "display_data", "metadata": {}, "data": shown(value)})
        os.chdir(ROOT)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
