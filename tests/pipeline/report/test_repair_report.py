"""A repair's page: an improvement is not red, links are beside the URDF's, who judged is said."""

import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import pytest

from armdyn.arm.links import LinkInertiaChange, LinkQuantity
from armdyn.document import MAX_CARD_ROWS, Column, Document, NextStep, ResultLevel, Section, Table
from armdyn.errors import UnknownNameError
from armdyn.identify.explained_share import ChannelScale, RepairStep
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.repair import Repair
from armdyn.identify.sentence import Verdict
from armdyn.identify.tables import error_fall_sentence, link_section, step_table
from armdyn.notebook import data_frame, html_card
from pipeline.answers import link_inertia_json
from pipeline.console.screen import finish_command, print_document
from pipeline.report.page import page_html

ZERO = ("centre_x", "centre_y", "centre_z", "inertia_xx", "inertia_xy", "inertia_yy", "inertia_xz", "inertia_yz")


def link(mass, determined):
    rest = [LinkQuantity(name, "m", 0.0, 1e-20, 0.1, False) for name in (*ZERO, "inertia_zz")]
    moments = [LinkQuantity(f"moment_{axis}", "kg m", 0.2, 0.25, 0.01, True) for axis in "xyz"]
    return LinkInertiaChange("elbow", (LinkQuantity("mass", "kg", 7.8, mass, 3.0, determined), *rest, *moments), True)


@pytest.mark.parametrize(
    ("verdict", "explained", "widened", "level"),
    [
        (Verdict.EXPLAINED, 0.99, 1.0, ResultLevel.GOOD),
        (Verdict.EXPLAINED, 0.99, 12.0, ResultLevel.IMPROVED),  # without structure, and far above the noise
        (Verdict.UNKNOWN_EFFECT, 0.97, 12.0, ResultLevel.IMPROVED),
        (Verdict.EFFECT_MISSING, 0.6, 12.0, ResultLevel.IMPROVED),
        (Verdict.UNKNOWN_EFFECT, 0.1, 12.0, ResultLevel.CAUTION),
        (Verdict.UNKNOWN_EFFECT, -0.2, 12.0, ResultLevel.BAD),
    ],
)
def test_a_repair_that_helps_is_never_failed(verdict, explained, widened, level):
    found = SimpleNamespace(verdict=verdict, explained=explained, after=SimpleNamespace(std_inflation=widened))
    assert Repair.level.fget(found) is level


def test_a_link_of_241_kg_does_not_pass_without_a_word(capsys):
    heavy = link(241.0, determined=False)
    expected = "the link of elbow weighs 241 kg in the model (URDF: 7.8 kg), which these runs do not determine"
    print_document(Document("Repair", "it is done", [link_section([heavy])]))
    shown = " ".join(capsys.readouterr().out.split())
    assert "mass 7.8 241 3 kg not by these runs" in shown
    assert "mass times centre z 0.2 0.25 0.01 kg m yes" in shown
    assert "centre of mass x 0 0 0.1 m not by these runs" in shown  # what rounding left of zero
    assert f"Look out: {expected}" in shown
    assert "4 of the 13" in link_section([link(8.0, determined=True)]).sentence
    answer = link_inertia_json(heavy)
    assert answer["warning"] == expected
    assert answer["mass"] == {"unit": "kg", "urdf": 7.8, "value": 241.0, "std": 3.0, "determined": False}


def test_the_repair_path_tells_total_errors_and_the_exams():
    given = RepairStep((), (), (), {"tau.a": 3.0, "tau.b": 4.0}, {"tau.a": 6.0, "tau.b": 8.0}, 9.0, 1.0, {"tau.a": 7.0})
    better = replace(given, added=("payload",), rmse={"tau.a": 0.3, "tau.b": 0.4}, held_out_rmse={}, exam_rmse={})
    path, scale = [given, better], ChannelScale({"tau.a": "N m", "tau.b": "N m"}, {})
    table = step_table(path, scale, (HoldoutKind.EXAM, HoldoutKind.HELD_OUT), {"payload": "A mass at the tool."})
    columns = {column.heading: column for column in table.columns}
    assert list(columns)[1:5] == ["fitted [N m]", "held out [N m]", "exam [N m]", "χ² per sample"]
    rows = list(zip(*(column.texts for column in table.columns), strict=True))
    assert rows[0][:5] == ("as given", "5", "10", "7", "9")
    assert (*rows[1][:4], rows[1][-1]) == ("+ payload", "0.5", "–", "–", "A mass at the tool.")
    assert columns["fitted [N m]"].bar_lengths == pytest.approx([1.0, 0.1])
    assert error_fall_sentence(path, scale) == "7 N m → – (exam) in 1 step."


TABLE = Table(
    [
        Column("effect", ["linear_drag", "<wind>", "path_tilt"]),
        Column("rmse_now", [0.0123456, None, 7.0], ".3g", missing_text="none"),
        Column("joints", [(), (), ()]),
        Column("what it is", ["air", "more air", "a tilt"], dropped_when_narrow=True),
        Column("bars", [1, 2, 3], bar_lengths=[0.1, 0.5, 1.0]),
    ],
    "Less is better.",
    "effects",
)


DOCUMENT = Document(
    "A result",
    "it is <so>",
    [Section("Evidence", "Three were tried.", tables=[TABLE])],
    ResultLevel.GOOD,
    notes=["look out"],
    next_steps=[NextStep("add it", "armdyn add m.toml")],
)


def on_a_terminal(capsys):
    print_document(DOCUMENT)
    return capsys.readouterr().out


def on_a_page(_):
    return unescape(re.sub(r"<(script|style).*?</\1>|<[^>]+>", " ", page_html(DOCUMENT), flags=re.S))


def in_a_notebook(_):
    return unescape(re.sub(r"<[^>]+>", " ", html_card(DOCUMENT)))


@pytest.mark.parametrize("shown", [on_a_terminal, on_a_page, in_a_notebook])
def test_the_verdict_and_every_cell_are_shown(shown, capsys):
    text = " ".join(shown(capsys).split())
    assert "it is <so>" in text
    for cell in ("effect", "rmse now", "linear_drag", "<wind>", "0.0123", "none", "7"):
        assert cell in text, cell
    assert "joints" not in text  # nothing stands in it
    assert ("more air" in text) is (shown is on_a_page)


def test_a_data_frame_holds_the_values_and_not_their_texts(complains):
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    made = data_frame(DOCUMENT, "effects")
    assert list(made.columns) == ["effect", "rmse_now", "joints", "what it is", "bars"]
    assert made["rmse_now"].iloc[0] == 0.0123456
    with complains(UnknownNameError):
        data_frame(DOCUMENT, "effect")


def test_a_long_table_says_how_much_of_it_is_left_out(capsys):
    long = Table([Column("number", list(range(MAX_CARD_ROWS + 7)))])
    print_document(Document("A result", "it is so", [Section("Numbers", tables=[long])]))
    assert "and 7 more" in capsys.readouterr().out


def test_json_on_standard_output_stands_alone_and_else_the_next_steps_are_said(capsys, tmp_path):
    from pathlib import Path

    finish_command(DOCUMENT, lambda: {"schema": "a/1"}, Path("-"), tmp_path / "r.html", lambda: DOCUMENT)
    assert capsys.readouterr().out == '{\n "schema": "a/1"\n}\n'
    assert "it is" in (tmp_path / "r.html").read_text()
    finish_command(DOCUMENT, lambda: {}, None, written=["written to m.toml"])
    said = capsys.readouterr().out
    assert said.index("look out") < said.index("written to m.toml") < said.index("add it: armdyn add m.toml")
