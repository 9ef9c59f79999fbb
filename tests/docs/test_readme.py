# SPDX-License-Identifier: BSD-3-Clause
import re
import runpy
import shutil
from importlib.resources import as_file, files
from pathlib import Path

import pytest
from typer.main import get_command

import faultrecon as fr
from faultrecon.cli.app import app
from faultrecon.methods.registry import all_methods

ROOT = next(p for p in Path(__file__).parents if (p / "README.md").exists() and (p / "pyproject.toml").exists())
README = (ROOT / "README.md").read_text(encoding="utf-8")
FENCES = re.findall(r"```(\w*)\n(.*?)```", README, re.DOTALL)
PROSE = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
CODE = "\n".join([*(text for _, text in FENCES), *re.findall(r"`([^`\n]+)`", PROSE)])
VERBS = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback is not None}


@pytest.mark.parametrize("name", ["demo", "tests"])
def test_a_command_marker_stands_exactly_once_around_one_command(name):
    assert README.count(f"<!-- {name} -->") == README.count(f"<!-- /{name} -->") == 1
    inside = README.partition(f"<!-- {name} -->")[2].partition(f"<!-- /{name} -->")[0]
    commands = [line for line in inside.strip().splitlines() if not line.startswith("```")]
    assert len(commands) == 1 and commands[0].startswith("python3 -m venv ")


def test_the_commands_are_the_demonstration_and_the_tests():
    demo, tests = (README.partition(f"<!-- {name} -->")[2].partition("<!-- /")[0] for name in ("demo", "tests"))
    assert "faultrecon demo airliner" in demo and "-m pytest" in tests


def test_the_python_of_the_readme_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    blocks = [text for language, text in FENCES if language == "python"]
    assert len(blocks) == 1
    with as_file(files("faultrecon") / "data" / "airliner" / "pitch_rate_calm.csv") as flight:
        shutil.copy(flight, tmp_path / "flight.csv")
    (tmp_path / "readme.py").write_text(blocks[0], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    made = runpy.run_path(str(tmp_path / "readme.py"))
    printed = capsys.readouterr().out
    assert "can be reconstructed" in printed and "certificate: proved" in printed
    assert fr.verify("design.json").verdict == "proved"
    table, plant = made["table"], made["plant"]
    assert len(table) == 3001
    assert {f"f_{f.name}" for f in plant.faults} <= set(table.columns)
    assert {"pitch_rate_corrected", "pitch_rate_ok"} <= set(table.columns)
    assert made["estimate"].fault.shape == (len(plant.faults),)


def test_every_verb_that_the_readme_uses_exists():
    used = set(re.findall(r"(?<!import )\bfaultrecon ([a-z]+)\b", CODE))
    assert used and used <= VERBS


def test_every_verb_is_mentioned_in_the_readme():
    named = set(re.findall(r"(?<!import )\bfaultrecon ([a-z]+)\b", CODE)) | set(CODE.splitlines())
    assert sorted(VERBS - named) == []


def test_every_option_in_the_readme_exists():
    commands = get_command(app).commands.values()  # type: ignore[attr-defined]  # the group of all verbs
    known = {option for command in commands for parameter in command.params for option in parameter.opts}
    faultrecon = [line for line in CODE.splitlines() if "pip install" not in line or "faultrecon demo" in line]
    used = {word for line in faultrecon for word in re.findall(r"(?<![\w-])--[a-z][a-z-]*", line.rpartition("&&")[2])}
    assert used <= known, used - known


def test_every_link_to_a_file_leads_somewhere():
    links = [link for link in re.findall(r"\]\(([^)#\s]+)", README) if "://" not in link]
    assert links and [link for link in links if not (ROOT / link).exists()] == []


def test_every_call_of_the_readme_is_public():
    assert set(re.findall(r"\bfr\.([a-z_]+)", CODE)) <= set(fr.__all__)


def test_the_table_of_methods_lists_the_methods_there_are():
    section = README.partition("## Methods")[2].partition("\n## ")[0]
    listed = set(re.findall(r"^\| `([a-z0-9-]+)` \|", section, re.MULTILINE))
    assert listed == {name for name, found in all_methods().items() if found.variant_of is None}
