"""What the README and the pages for users promise."""

import re
from pathlib import Path

import pytest

from armdyn.run import read_run
from pipeline.imports.mapping import read_map

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
FORMATS = (ROOT / "docs/formats.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README + FORMATS, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda text: text.split("\n")[0][:40])
def test_examples_run(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})


def test_links_and_pictures_exist():
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    missing = [target for target in targets if not (ROOT / target).exists()]
    assert not missing


def test_two_commands_do_the_setting_up():
    commands = re.search(r"```sh\n(.*?)```", README, re.DOTALL).group(1).strip().splitlines()
    assert len(commands) == 2
    assert commands[0].endswith("armdyn trial")
    assert commands[1].endswith("pytest")


def test_the_run_that_is_shown_is_one(tmp_path):
    header, *rows = re.search(r"```\n(time \[s\].*?)```", FORMATS, re.DOTALL)[1].strip().splitlines()
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join([header, *(row.replace(row[:5], f"{i / 100:.3f}") for i, row in enumerate(rows * 5))]) + "\n"
    )
    sidecar = re.search(r"```toml\n(description = \"swing.*?)```", FORMATS, re.DOTALL)[1]
    path.with_suffix(".toml").write_text(sidecar)
    run = read_run(path)
    assert run.joints == ("shoulder", "elbow")
    assert run.noise == {"load_force": 0.003, "tau.elbow": 0.2}


def test_the_mapping_that_is_shown_is_one(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(re.search(r"```toml\n(time = .*?)```", FORMATS, re.DOTALL)[1])
    assert [entry.channel for entry in read_map(path).entries.values()] == ["q.shoulder", "q.elbow", "tau.elbow"]
