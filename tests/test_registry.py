"""Rows of the registries: what each names is there, and to list them imports nothing slow."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lieednn_sim import registry
from lieednn_sim.entries import LIBRARIES, Entry, Registry
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.registry import FORMATS, PLANNERS, SCENES

ALL = [value for value in vars(registry).values() if isinstance(value, Registry)]


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.kind)
def test_every_row_has_a_help_and_what_it_names_is_there(kind):
    assert len(kind) > 1
    for name, entry in kind.items():
        assert entry.own
        assert entry.help, name
        assert not entry.library or entry.library in LIBRARIES, name
        assert not entry.takes or entry.options.__name__ == entry.takes
        assert not entry.place or callable(entry.load()), name


def test_a_list_of_names_imports_nothing_slow():
    code = "import sys, lieednn_sim.registry as r; list(r.PLANNERS.entries); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {"numpy", "mujoco", "importlib.metadata"}.isdisjoint(loaded)


def test_names_are_looked_up_with_those_that_there_are():
    assert PLANNERS.find("stomp") is PLANNERS["stomp"]
    with pytest.raises(InputError, match="no planner 'stamp'; allowed: aorrtc, bit-star"):
        PLANNERS.find("stamp")
    with pytest.raises(InputError, match="no bias rule 'loud'; allowed: sign-matched, solved, uniform"):
        registry.BIAS_RULES.find("loud")


def test_what_is_not_installed_is_named_with_its_extra_and_what_else_there_is(monkeypatch):
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: name)
    assert PLANNERS.missing() == {}
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda _: None)
    assert PLANNERS.missing()["bit-star"] == FORMATS["rerun"].install.replace("rerun", "rivals")
    PLANNERS.require("stomp")
    words = r"'bit-star' is not installed: pip install 'lieednn_sim\[rivals\]'; or name one without extra: minimum-jerk"
    with pytest.raises(LieEDNNError, match=words):
        PLANNERS.require("bit-star")
    assert registry.purpose("pyarrow") == "format lerobot"
    with pytest.raises(LieEDNNError, match=r"ompl is not installed \(for planners rrt-connect, .*\): pip install"):
        registry.optional_module("ompl.nowhere")
    monkeypatch.setattr(registry.importlib, "import_module", lambda _: exec("raise ImportError('no libboost.so')"))
    with pytest.raises(LieEDNNError, match=r"ompl cannot be imported, since no libboost.so \(for .*\): pip"):
        registry.optional_module("ompl.geometric")


def test_things_of_others_come_with_their_options_and_where_they_are_from():
    kind = Registry("thing", {}, make=Entry, wanted="a function")

    class Options: ...

    thing = kind.register("own-thing", Options)(lambda: 5)
    assert not kind["own-thing"].own
    assert (kind["own-thing"].load(), kind["own-thing"].options) == (thing, Options)
    (line,) = kind.origins(["own-thing", "elsewhere"])
    assert line.startswith(f"thing own-thing: {__name__}.")
    with pytest.raises(InputError, match="thing 'other' must be a function, got int"):
        kind.register("other")(3)


def test_a_thing_that_is_defined_again_takes_the_place_of_the_first_one_and_no_other_does():
    """As by a cell of a notebook that is run again."""
    kind, cell = (
        Registry("thing", {"ours": Entry("where:it")}, make=Entry, wanted="a function"),
        "def thing(): return {}",
    )
    for value in (1, 2):
        exec(cell.format(value), notebook := {"__name__": "__main__"})
        assert kind.register("mine")(notebook["thing"])() == kind["mine"].load()() == value
    for name, other in (("mine", lambda: 3), ("mine", 3), ("ours", lambda: 3)):
        with pytest.raises(InputError, match=f"thing '{name}' is already registered; choose another name"):
            kind.register(name)(other)


def test_a_thing_of_a_file_is_run_only_when_it_is_named_and_says_what_is_wrong(tmp_path, monkeypatch):
    kind = Registry("thing", {}, make=Entry, wanted="a function")
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "beside_mine.py").write_text("VALUE = 7\n")
    mine = tmp_path / "things-of-mine.py"
    mine.write_text("from beside_mine import VALUE\nnumber = 3\ndef thing(): return VALUE\n")
    name = f"{mine}:thing"
    assert name not in kind
    assert "things-of-mine" not in sys.modules
    assert kind.find(name).load()() == 7
    assert not kind[name].own
    (tmp_path / "failing.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "json.py").write_text("def thing(): ...\n")
    for wrong, words in {
        f"{tmp_path}/nowhere.py:thing": "there is no file .*nowhere.py",
        f"{mine}:other": "has no 'other'; it has thing$",
        f"{mine}:number": "must be a function, got int",
        f"{tmp_path}/failing.py:thing": "running .*failing.py fails: SystemExit: 3",
        f"{tmp_path}/json.py:thing": "another module named 'json': give the file another name",
    }.items():
        with pytest.raises(InputError, match=words):
            kind.find(wrong)
        assert wrong not in kind
    with pytest.raises(InputError, match="no scene"):
        SCENES.find(name)
