"""What the README says runs: each Python block by itself, as it stands; each command line as far as its parser.

So do the Python blocks of the document on policies.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from lieednn_sim.cli import _parser
from lieednn_sim.policies.registry import REGISTRY

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str, text: str = README, name: str = "") -> list:
    """The code blocks of a language in a document, named by the line that they begin at."""
    found = re.finditer(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [pytest.param(match[1], id=f"{name}line {text[: match.start()].count(chr(10)) + 2}") for match in found]


POLICIES = blocks("python", (ROOT / "docs" / "howto" / "policies.md").read_text(), "policies.md ")
COMMANDS = [line for block in blocks("sh") for line in block.values[0].splitlines()]


@pytest.mark.parametrize("code", [*blocks("python"), *POLICIES])
def test_each_python_block_runs_by_itself(code, tmp_path, monkeypatch, capsys):
    modules = set(re.findall(r"^import (gymnasium|dm_control)", code, re.MULTILINE))
    modules |= {"ompl"} if "lieednn-guided" in code else set()
    for module in modules:
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    before = dict(REGISTRY.given)
    try:
        exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    finally:
        REGISTRY.forget(before)
    assert "False" not in capsys.readouterr().out


@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("lieednn-sim ")])
def test_each_command_line_is_understood(line):
    words = shlex.split(line, comments=True)
    assert _parser().parse_args(words[1:]).command == words[1]


def test_the_targets_of_make_and_the_extras_are_those_there_are():
    makefile, script = (ROOT / "Makefile").read_text(), (ROOT / "scripts" / "ensure_env.sh").read_text()
    for target in re.findall(r"make ([a-z]+)", "\n".join(COMMANDS)):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)
    rows = dict(re.findall(r"^\| `(\w+)` (.*(?:`make test`.*|neither) \|)$", README, re.MULTILINE))
    assert set(rows) == set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    installed = ",".join(name for name, row in rows.items() if "`make demo`" in row)
    assert f"\nextras={installed}\n" in script
    assert f"'.[{installed}]'" in README
