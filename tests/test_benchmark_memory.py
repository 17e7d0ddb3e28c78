"""The benchmark of workers' memory, with as few cases as can be, and that workers give memory back."""

from __future__ import annotations

import benchmark_memory

from lieednn_sim.evaluation import workers


def test_memory_is_read_after_shares_of_the_cases(tmp_path, capsys):
    benchmark_memory.main(["--cases", "2", "--studies", "comparison,problems", "--output", str(tmp_path)])
    (line,) = capsys.readouterr().out.splitlines()
    name, *figures = (cell.strip() for cell in line.strip("|").split("|"))
    assert name == "comparison"
    assert 50 < float(figures[-1]) < 2000
    assert line in (tmp_path / "memory.md").read_text()


def test_memory_is_given_back_after_each_task_even_if_it_fails(monkeypatch):
    given = []
    monkeypatch.setattr(workers, "_trim", lambda: given.append)
    assert workers.released(lambda a, b: a + b, 1, 2) == 3
    try:
        workers.released(lambda: 1 / 0)
    except ZeroDivisionError:
        given.append("failed")
    assert given == [0, 0, "failed"]
