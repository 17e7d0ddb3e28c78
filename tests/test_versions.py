"""The hash of the code: what changes it, and which modules count."""

from __future__ import annotations

import pytest

from lieednn_sim.versions import code_version, modules

FILES = {
    "lieednn_sim/__init__.py": "",
    "lieednn_sim/arm/__init__.py": "from lieednn_sim.arm.model import Arm\nfrom lieednn_sim.arm.other import Other\n",
    "lieednn_sim/arm/model.py": 'class Arm:\n    """An arm."""\n\n    length = 1.5\n',
    "lieednn_sim/arm/other.py": "Other = 1\n",
    "lieednn_sim/io.py": "digits = 6\n",
    "lieednn_sim/lazy.py": "x = 1\n",
    "lieednn_sim/deep.py": "y = 1\n",
    "lieednn_sim/rendering/film.py": "from lieednn_sim.rendering import light\nsize = 2\n",
    "lieednn_sim/rendering/light.py": "sun = 1\n",
    "lieednn_sim/rendering/__init__.py": "",
    "scripts/study.py": (
        "import numpy as np\nfrom rows import read\nfrom lieednn_sim import io\n"
        "from lieednn_sim.arm import Arm\nfrom lieednn_sim.rendering import film\n"
    ),
    "scripts/rows.py": "def read():\n    from lieednn_sim.lazy import x\n    return x, 'lieednn_sim.deep'\n",
    "assets/mjcf/a/a.xml": "<mujoco/>",
}


@pytest.fixture
def version(tmp_path):
    """The hash for a script, with one file changed."""
    made = []

    def of(name="", text="", roots=("study",)):
        folder = tmp_path / str(len(made))
        made.append(folder)
        for path, content in {**FILES, **({name: text} if name else {})}.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(content)
        return code_version(*roots, folder=folder)

    return of


def test_comments_docstrings_and_layout_do_not_count_and_a_constant_does(version):
    name = "lieednn_sim/arm/model.py"
    for same in (
        "# Why.\nclass Arm:\n    length = (\n        1.5  # [m]\n    )\n",
        "class Arm:\n    'Old.'\n    length=1.5",
    ):
        assert version(name, same) == version()
    for other in (
        "class Arm:\n    length = 1.6\n",
        "class Arm:\n    length = '1.5'\n",
        "class Arm:\n    width = 1.5\n",
    ):
        assert version(name, other) != version()


def test_a_script_depends_on_what_it_imports_in_turn(version):
    for name in ("scripts/rows.py", "lieednn_sim/lazy.py", "lieednn_sim/deep.py", "assets/mjcf/a/a.xml"):
        assert version(name, "z = 2") != version(), name
    # A wheel holds the models.
    assert version("lieednn_sim/assets/mjcf/a/a.xml", FILES["assets/mjcf/a/a.xml"]) == version()
    # A room's name is that of the module in it; files and films change no number.
    for name in ("arm/other.py", "io.py", "rendering/film.py", "rendering/light.py"):
        assert version(f"lieednn_sim/{name}", "z = 2") == version(), name
    # Unless the film is what is made.
    roots = ("lieednn_sim.rendering.film",)
    assert version("lieednn_sim/rendering/light.py", "z = 2", roots) != version(roots=roots)


def test_rows_of_tables_depend_on_planners_and_simulation_but_not_on_commands_and_pages():
    found = {name.removeprefix("lieednn_sim.") for name in modules()}
    assert found >= {
        *("planning.certified", "planning.baselines.cbirrt", "learning.projected", "arm.importer.importing"),
        *(
            "simulation.simulation",
            "studies.comparison.cases",
            "studies.statistics",
            "stability.certificate",
            "lie.se3",
        ),
    }
    assert not {name.split(".")[0] for name in found} & {"cli", "rendering", "environments", "io", "validation"}
    assert "studies.report.page" not in found
    assert len(code_version()) == 12
