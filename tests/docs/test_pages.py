"""What the pages show is what their commands print, and the pictures are those of what they write."""

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
import pages

QUICK = "docs/inspect.md"
"""The page whose commands take seconds; of a trial, a repair of an arm or a lab they take minutes."""


@pytest.mark.parametrize("page", [pytest.param(p, marks=[] if p == QUICK else pytest.mark.slow) for p in pages.PAGES])
def test_a_page_shows_what_its_commands_print_and_draw(page, tmp_path):
    if shutil.which("chromium") is None:
        pytest.skip("pictures of pages need Chromium: apt-get install chromium")
    folder, made = tmp_path / "work", tmp_path / "pictures"
    folder.mkdir()
    made.mkdir()
    for shown, now in pages.run(page, folder, made):
        assert now == list(shown.lines), shown.command
    another = {path.name: pages.difference(pages.ROOT / "docs/pictures" / path.name, path) for path in made.iterdir()}
    assert {name for name, picture in pages.PICTURES.items() if picture.page == page} <= another.keys()
    assert {name: size for name, size in another.items() if size > pages.ANOTHER} == {}


def test_a_number_may_round_otherwise_and_no_word_may():
    shown = pages.Displayable(1, "armdyn", ("it falls from 22.8 ... to 0.201 N m", "in 5 steps"))
    assert pages.up_to_date(shown, "it falls from 22.9 or so to 0.202 N m in 5 steps") == list(shown.lines)
    assert pages.up_to_date(shown, "it falls from 24.9 or so to 0.2 N m in 5 steps")[0][:22] == "it falls from 24.9 ..."
    with pytest.raises(AssertionError, match="line 3: not printed: 'in 5 steps'"):
        pages.up_to_date(shown, "in 5 steps it falls from 22.8 to 0.201 N m")
