"""Terminal, page and notebook show one document: the same sentences, the same cells."""

import re
from html import unescape

import pytest

from armdyn.document import MOST_ROWS, Column, Document, Level, NextStep, Section, Table
from armdyn.errors import UnknownNameError
from armdyn.notebook import card, frame
from pipeline.console.screen import finish, show
from pipeline.report.page import page_html

VALUES = [0.0123456, None, 7.0]
TABLE = Table(
    [
        Column("effect", ["linear_drag", "<wind>", "path_tilt"]),
        Column("rmse_now", VALUES, ".3g", missing="none"),
        Column("joints", [(), (), ()]),
        Column("what it is", ["air", "more air", "a tilt"], wide=True),
        Column("bars", [1, 2, 3], shares=[0.1, 0.5, 1.0]),
    ],
    "Less is better.",
    "effects",
)
DOCUMENT = Document(
    "A result",
    "it is <so>",
    [Section("Evidence", "Three were tried.", tables=[TABLE])],
    Level.GOOD,
    notes=["look out"],
    next_steps=[NextStep("add it", "armdyn add m.toml")],
)


def on_a_terminal(capsys):
    show(DOCUMENT)
    return capsys.readouterr().out


def on_a_page(_):
    return unescape(re.sub(r"<(script|style).*?</\1>|<[^>]+>", " ", page_html(DOCUMENT), flags=re.S))


def in_a_notebook(_):
    return unescape(re.sub(r"<[^>]+>", " ", card(DOCUMENT)))


@pytest.mark.parametrize("shown", [on_a_terminal, on_a_page, in_a_notebook])
def test_the_verdict_and_every_cell_are_shown(shown, capsys):
    text = " ".join(shown(capsys).split())
    assert "it is <so>" in text
    for cell in ("effect", "rmse now", "linear_drag", "<wind>", "0.0123", "none", "7"):
        assert cell in text, cell
    assert "joints" not in text  # nothing stands in it
    assert ("more air" in text) is (shown is on_a_page)


def test_a_data_frame_holds_the_values_and_not_their_texts():
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    made = frame(DOCUMENT, "effects")
    assert list(made.columns) == ["effect", "rmse_now", "joints", "what it is", "bars"]
    assert made["rmse_now"].iloc[0] == VALUES[0]
    with pytest.raises(UnknownNameError, match="effects"):
        frame(DOCUMENT, "effect")


def test_a_long_table_says_how_much_of_it_is_left_out(capsys):
    long = Table([Column("number", list(range(MOST_ROWS + 7)))])
    show(Document("A result", "it is so", [Section("Numbers", tables=[long])]))
    assert "and 7 more" in capsys.readouterr().out


def test_json_on_standard_output_stands_alone_and_else_the_next_steps_are_said(capsys, tmp_path):
    from pathlib import Path

    finish(DOCUMENT, lambda: {"schema": "a/1"}, Path("-"), tmp_path / "r.html", lambda: DOCUMENT)
    assert capsys.readouterr().out == '{\n "schema": "a/1"\n}\n'
    assert "it is" in (tmp_path / "r.html").read_text()
    finish(DOCUMENT, lambda: {}, None, written=["written to m.toml"])
    said = capsys.readouterr().out
    assert said.index("look out") < said.index("written to m.toml") < said.index("add it: armdyn add m.toml")
