"""What the README and the site's pages say runs: a page's Python blocks in order, command lines as far as the parser.

Links lead somewhere, and the README stays short.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from PIL import Image

from lieednn_sim.cli import bind

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    path
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if not {"_build", "_made"} & set(path.relative_to(ROOT).parts)
]
TEXTS = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in PAGES}
# tests/planning/test_own_planners.py, tests/simulation/test_own_controllers.py and tests/policies/test_policy_c_code.py
# run their blocks, and try more.
ELSEWHERE = {"docs/howto/own_planner.md", "docs/howto/own_controller.md", "docs/howto/policy_as_code.md"}
# Modules of extras, and what in a page needs them.
OPTIONAL = {
    "gymnasium": r"^import gymnasium",
    "dm_control": r"^import dm_control",
    "ompl": r"rrt-connect",
    "viser": r"render_page\(",
}


def blocks(text: str, languages: str) -> list[tuple[int, str]]:
    """The line before each code block's first, and the block."""
    found = re.finditer(rf"^```(?:{languages})\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [(text[: match.start(1)].count("\n"), match[1]) for match in found]


PYTHON = {page: found for page, text in TEXTS.items() if page not in ELSEWHERE and (found := blocks(text, "python"))}
# What takes long and shows the same where there is less of it.
SHORTER = {
    "docs/howto/swinging_loads.md": (
        ("hold=5.0", "hold=0.2"),
        ("(0.8, 1.2)", "(0.8,)"),
        ("[1.2, 0.8, 1.0], duration=10.0", "[0.1, 0.55, 0.55], duration=2.0"),
    ),
    "docs/howto/action_chunks.md": (("duration=4.0", "duration=1.0"),),
    "docs/howto/compare.md": (("seeds=2,", "seeds=1,"),),
    "docs/howto/policies.md": (("duration=4.0", "duration=1.0"), ("duration=2.0", "duration=1.0")),
    "docs/howto/demonstrations.md": (
        ("for bend in bends])", "for bend in bends], samples=60)"),
        ("duration=12.0", "duration=2.0"),
    ),
    "docs/howto/environments.md": (("for seed in range(3)", "for seed in range(1)"),),
    "docs/howto/robot_loop.md": (("duration=0.5", "duration=0.05"),),
}
COMMANDS = {
    (page, line): None
    for page, text in TEXTS.items()
    for _, block in blocks(text, "sh|bash")
    for line in block.replace("\\\n", " ").splitlines()
}


@pytest.mark.usefixtures("own_names", "no_plots")
@pytest.mark.parametrize("page", PYTHON)
def test_the_python_blocks_of_a_page_run_in_order(page, tmp_path, monkeypatch, capsys):
    code = "\n".join(block for _, block in PYTHON[page])
    for module, need in OPTIONAL.items():
        if re.search(need, code, re.MULTILINE):
            pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    shorter = SHORTER.get(page, ())
    assert all(usual in code for usual, _ in shorter)
    for line, block in PYTHON[page]:
        for usual, less in shorter:
            block = block.replace(usual, less)
        exec(compile("\n" * line + block, ROOT / page, "exec"), names)
    # What a page prints is a success, unless it says otherwise.
    assert "False" not in capsys.readouterr().out or "# False" in code


@pytest.mark.parametrize("line", [line for _, line in COMMANDS if line.startswith("lieednn-sim ")])
def test_each_command_line_is_understood(line):
    command, *words = shlex.split(line, comments=True)[1:]
    assert bind([command, *words]).func.__name__ == command


def test_the_targets_of_make_are_those_there_are():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^make ([a-z-]+)", "\n".join(line for _, line in COMMANDS), re.MULTILINE)
    assert {"demo", "test"} <= set(targets)
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_the_extras_are_those_there_are():
    page, script = TEXTS["docs/start/index.md"], (ROOT / "scripts" / "ensure_env.sh").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` (.*(?:`make test`.*|neither) \|)$", page, re.MULTILINE))
    assert set(rows) == set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    installed = ",".join(name for name, row in rows.items() if "`make demo`" in row)
    assert f"\nextras={installed}\n" in script
    assert f"'.[{installed}]'" in page


def test_the_readme_has_at_most_130_lines():
    assert len(TEXTS["README.md"].splitlines()) <= 130


def test_the_moving_pictures_of_the_first_screen_are_of_one_size_and_small():
    # Each in a table of its own, which a narrow page puts below one another, in the width of the column.
    loops = re.findall(r'<table align="left"><tr><td width="270"><img src="(\S+\.gif)" alt=".+?">', TEXTS["README.md"])
    assert len(loops) == 3
    for name in loops:
        with Image.open(ROOT / name) as picture:
            assert (picture.size, picture.n_frames > 20) == ((640, 360), True)
        assert (ROOT / name).stat().st_size < 1.2e6


def test_no_relative_link_is_broken():
    """Files and headings; generated pages, below `_made`, are left to Sphinx."""
    broken = []
    for path in {*PAGES, *ROOT.glob("*.md"), *(ROOT / "results").glob("*.md")}:
        text = path.read_text(encoding="utf-8")
        prose = re.sub(r"^```.*?^```|\$\$.*?\$\$|`[^`\n]*`|\$[^$\n]+\$", "", text, flags=re.MULTILINE | re.DOTALL)
        for target, heading in re.findall(r"""(?:\]\(<?|(?:href|src)="(?!\.))([^)#\s>"]*)(#[^)\s"]*)?""", prose):
            aim = path.parent / target if target else path
            if re.match(r"[a-z]+:", target) or "_made" in aim.parts:
                continue
            if not aim.exists() or (heading and aim.suffix == ".md" and heading[1:] not in anchors(aim)):
                broken.append(f"{path.relative_to(ROOT)}: {target}{heading}")
    assert not broken, "\n".join(sorted(broken))


def anchors(path: Path) -> set[str]:
    """The names by which a page's headings, and those that it includes, are linked, and labels in parentheses."""
    text = path.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    names = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    included = [anchors(path.parent / name) for name in re.findall(r"^```\{include\} (.*)$", text, re.MULTILINE)]
    return names.union(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE), *included)
