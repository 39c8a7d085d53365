"""A model or a batch of someone else runs no code outside its folder before the user has allowed it, once."""

import shutil
from pathlib import Path

import pytest

from armdyn import user_code
from armdyn.errors import InputError
from armdyn.model_file import read_model

CRANE = Path(__file__).parents[2] / "examples" / "crane.py"


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """A folder with a model whose base lies beside the folder; nothing has been allowed."""
    monkeypatch.setenv("ARMDYN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(user_code._Trust, "digests", set())
    (tmp_path / "cache").mkdir(mode=0o700)
    (tmp_path / "sent").mkdir()
    shutil.copy(CRANE, tmp_path / "crane.py")
    (tmp_path / "sent" / "m.toml").write_text('base = "../crane.py"\neffects = []\n')
    return tmp_path / "sent"


def test_code_outside_the_folder_asks_once_and_again_when_it_changes(asked, complains, monkeypatch):
    with complains(InputError):
        read_model(asked / "m.toml")
    with user_code.trusting_code():
        read_model(asked / "m.toml")
    monkeypatch.setattr(user_code._Trust, "digests", set())  # another process
    read_model(asked / "m.toml")
    (asked.parent / "crane.py").write_text(CRANE.read_text() + "\n")
    with pytest.raises(InputError, match="--trust-code"):
        read_model(asked / "m.toml")


def test_code_in_the_folder_runs_and_a_link_out_of_it_asks(asked):
    shutil.move(asked.parent / "crane.py", asked / "crane.py")
    (asked / "m.toml").write_text('base = "crane.py"\neffects = []\n')
    assert read_model(asked / "m.toml").names
    shutil.move(asked / "crane.py", asked.parent / "other.py")
    (asked.parent / "other.py").write_text(CRANE.read_text() + "\n")
    (asked / "crane.py").symlink_to(asked.parent / "other.py")
    with pytest.raises(InputError, match="--trust-code"):
        read_model(asked / "m.toml")


def test_the_option_stands_anywhere_and_a_batch_asks_for_its_effects(asked, armdyn):
    (asked.parent / "e.py").write_text((CRANE.parent / "my_effects.py").read_text())
    (asked / "p.toml").write_text('base = "pendulum"\neffects = []\n')
    shutil.copy(CRANE.parent / "pendulum" / "swing_1.csv", asked / "a.csv")
    (asked / "s.toml").write_text('effects = "../e.py"\n[[recordings]]\nmodel = "p.toml"\nruns = ["a.csv"]\n')
    status, _, err = armdyn("batch", asked / "s.toml", "--output", "out", "--workers", "1")
    assert (status, err.count("\n")) == (2, 1)
    assert "e.py is Python code from outside the folder" in err
    assert armdyn("batch", asked / "s.toml", "--trust-code", "--output", "out", "--workers", "1")[0] == 0
