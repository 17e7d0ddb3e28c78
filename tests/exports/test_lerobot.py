"""Data sets of LeRobot: by the rules of its format, read by pyarrow, and by the reader of rerun where that is there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.errors import FileError, InputError, NoSolutionError
from lieednn_sim.exports import export, formats, record

parquet = pytest.importorskip("pyarrow.parquet")


def check_format(folder):
    """Check a data set by the rules of version 3.0; returns its frames by feature, its episodes, and its info."""
    info, stats = (json.loads((folder / "meta" / f"{name}.json").read_text()) for name in ("info", "stats"))
    assert info["codebase_version"] == "v3.0"
    first = {"chunk_index": 0, "file_index": 0}
    table = parquet.read_table(folder / info["data_path"].format(**first))
    episodes = parquet.read_table(folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    tasks = parquet.read_table(folder / "meta" / "tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]
    assert table.schema.names == list(info["features"]) == list(stats)
    assert (info["total_episodes"], info["total_frames"]) == (len(episodes), len(table))
    assert info["splits"] == {"train": f"0:{len(episodes)}"}
    frames = {}
    for name, feature in info["features"].items():
        column = table.column(name)
        frames[name] = values = np.array(column.to_pylist(), dtype=feature["dtype"])
        assert list(values.shape[1:] or (1,)) == feature["shape"], name
        size = values[0].size
        kind = column.type if values.ndim == 1 else column.type.value_type
        assert str(kind) == {"float32": "float", "bool": "bool", "int64": "int64"}[feature["dtype"]]
        assert feature["names"] is None or len(feature["names"]) == size
        for what in ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"):
            assert len(stats[name][what]) == size
        np.testing.assert_allclose(stats[name]["mean"], values.reshape(len(values), -1).mean(0, dtype=float))
        assert stats[name]["count"] == [len(values)]
    np.testing.assert_array_equal(frames["index"], np.arange(len(table)))
    np.testing.assert_allclose(frames["timestamp"], frames["frame_index"] / info["fps"], rtol=1e-6)
    begin = 0
    for number, episode in enumerate(episodes):
        rows = slice(begin, begin + episode["length"])
        assert (episode["episode_index"], episode["data/chunk_index"], episode["data/file_index"]) == (number, 0, 0)
        assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (rows.start, rows.stop)
        assert (frames["episode_index"][rows] == number).all()
        np.testing.assert_array_equal(frames["frame_index"][rows], np.arange(episode["length"]))
        assert episode["tasks"] == tasks.column("__index_level_0__").to_pylist()
        assert episode["stats/action/count"] == [episode["length"]]
        begin = rows.stop
    assert begin == len(table)
    return frames, episodes, info


def read_by_rerun(folder):
    """The numbers of the episodes and the names of the features, by a reader of others."""
    experimental = pytest.importorskip("rerun.experimental")
    reader = experimental.LeRobotReader(folder)
    assert reader.version == "v3"
    found = {str(chunk.entity_path).lstrip("/") for chunk in reader.stream(reader.episodes()[-1])}
    return reader.episodes(), found


def test_episodes_of_the_expert_become_a_data_set_that_can_be_replayed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "--format", "lerobot", "--episodes", "2", "--seed", "5", "--output", "out"]) == 0
    assert "wrote in out/meta: info.json" in capsys.readouterr().out
    frames, episodes, info = check_format(tmp_path / "out")
    assert info["fps"] == 50
    assert [episode["seed"] for episode in episodes] == [5, 6]
    assert all(episode["certificate"].startswith("globally stable") for episode in episodes)
    last = [episode["dataset_to_index"] - 1 for episode in episodes]
    assert np.flatnonzero(frames["next.done"]).tolist() == last
    assert frames["next.success"][last].all()
    # The actions lead through the same states again, but for their 32 bits.
    task = make_task("reach")
    observation = task.begin(np.random.default_rng(6))
    np.testing.assert_array_equal(episodes[1]["target"], task.target(0.0))
    rows = slice(episodes[1]["dataset_from_index"], None)
    for action, state, left, reward in zip(
        *(frames[name][rows] for name in ("action", "observation.state", "observation.environment_state")),
        frames["next.reward"][rows],
        strict=True,
    ):
        seen = np.concatenate([observation[name] for name in ("position", "velocity", "command")])
        np.testing.assert_allclose(state, seen, atol=1e-4)
        np.testing.assert_allclose(left[:8], observation["position_error"], atol=1e-4)
        observation, again, *_ = task.step(action.astype(float))
        assert reward == pytest.approx(again, abs=1e-3)
    assert info["features"]["observation.state"]["names"][8] == "turn velocity"
    numbers, found = read_by_rerun(tmp_path / "out")
    assert numbers == [0, 1]
    assert found >= {"observation.state", "observation.environment_state", "action", "next.reward"}


def test_runs_become_the_episodes_of_a_data_set(rollout, tmp_path):
    shorter = make_rollout(rollout.arm, rollout.q[:31], q_ref=rollout.q_ref[:31])
    export({"long": rollout, "short": shorter}, tmp_path, format="lerobot")
    frames, episodes, info = check_format(tmp_path)
    assert [(one["run"], one["length"]) for one in episodes] == [("long", 25), ("short", 15)]
    np.testing.assert_array_equal(frames["action"][:25], rollout.q_ref[2::2].astype(np.float32))
    np.testing.assert_array_equal(frames["observation.state"][25:, :8], rollout.q[:30:2].astype(np.float32))
    assert read_by_rerun(tmp_path)[0] == [0, 1]
    assert info["robot_type"] == "telescopic_pr"


@pytest.mark.parametrize(
    ("timestep", "default", "rates"), [(0.002, 50, {30: 25, 60: 50, 29.4118: 25}), (1.0 / 240.0, 48, {50: 48, 31: 30})]
)
def test_frames_per_second_are_whole_and_divide_the_simulations(rollout, tmp_path, timestep, default, rates):
    run = replace(rollout, t=timestep * np.arange(len(rollout.t)))
    export(run, tmp_path / "out", format="lerobot")
    assert check_format(tmp_path / "out")[2]["fps"] == default
    for rate, nearest in rates.items():
        with pytest.raises(InputError, match=f"whole number of frames .*, got {rate:g} Hz; for example {nearest} Hz"):
            export(run, tmp_path / "new", format="lerobot", rate=float(rate))
        export(run, tmp_path / f"{nearest}", format="lerobot", rate=float(nearest))
    slow = replace(rollout, t=0.003 * np.arange(len(rollout.t)))
    for asked in (None, 50.0):
        with pytest.raises(InputError, match=r"none divides the simulation's 333.333 Hz; simulate with another"):
            export(slow, tmp_path / "new", format="lerobot", rate=asked)


def test_what_makes_no_data_set_is_refused(rollout, tmp_path, monkeypatch):
    other = make_rollout(Arm.load("telescopic_rrp"))
    with pytest.raises(InputError, match="of one arm"):
        export({"one": rollout, "other": other}, tmp_path, format="lerobot")
    with pytest.raises(InputError, match="too short"):
        export(make_rollout(rollout.arm), tmp_path, format="lerobot", rate=1.0)
    with pytest.raises(InputError, match="whole number of frames per second"):
        export(rollout, tmp_path, format="lerobot", rate=12.5)
    monkeypatch.setattr(formats, "_episode", lambda *_: None)
    with pytest.raises(NoSolutionError, match="only 0 of 20 episodes succeeded, 1 are wanted"):
        record(tmp_path / "new", 1)
    (tmp_path / "mine" / "meta").mkdir(parents=True)
    (tmp_path / "mine" / "meta" / "info.json").write_text("{}")
    with pytest.raises(FileError, match="no command of this package made"):
        record(tmp_path / "mine", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
