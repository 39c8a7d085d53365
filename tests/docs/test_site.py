"""The documentation is a site that builds without a warning: every link, every anchor, every name of the reference."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for module in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(module, reason="the site needs mkdocs: pip install 'armdyn[docs]'")
    target = tmp_path_factory.mktemp("site")
    command = ["build", "--strict", "--quiet", "--config-file", ROOT / "docs/site/mkdocs.yml", "--site-dir", target]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run([sys.executable, "-m", "mkdocs", *command], capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stderr[-3000:]
    return target


def test_the_reference_shows_the_front_door(site):
    page = (site / "python/index.html").read_text()
    for name in ("armdyn.front.repair", "armdyn.run.Run.from_arrays", "armdyn.shown.Shown.to_dataframe"):
        assert f'id="{name}"' in page
    assert "recordings that take part in choosing effects, never in a fit" in page


def test_every_page_of_the_documentation_is_in_it(site):
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert pages <= {path.parent.name for path in site.rglob("index.html")}


def test_nothing_is_loaded_from_elsewhere(site):
    assert "fonts.googleapis" not in (site / "index.html").read_text()
