"""Models compared: each is fitted without what it is asked to foretell, and the table says what was found."""

from __future__ import annotations

import numpy as np
import pytest
from evaluate_demonstrations import main

from lieednn_sim.entries import Entry, Registry
from lieednn_sim.errors import FileError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.studies.demonstrations import models as compared
from lieednn_sim.studies.demonstrations import models as paths
from lieednn_sim.studies.demonstrations.models import compare_models
from lieednn_sim.synthesis import ShapingOptions


class Recaller:
    """Knows the paths it was shown, and goes the one whose start is nearest."""

    name, durations, n_parameters = "recaller", 1.0, 0

    def __init__(self, shown):
        self.shown = shown

    def reproduce(self, start, t):
        if start.ndim > 1:
            return np.stack([self.reproduce(one, t) for one in start])
        nearest = np.argmin(np.linalg.norm(self.shown.twists[:, 0] - start, axis=1))
        share = t / self.shown.duration * (len(self.shown.t) - 1)
        return np.stack([np.interp(share, np.arange(len(self.shown.t)), c) for c in self.shown.twists[nearest].T], -1)


def test_what_is_left_out_was_not_seen(monkeypatch):
    rows = [[[0.3, 0.1 * k], [0.0, 0.1 * k]] for k in (0.0, 0.1, 0.5)]
    # Straight to a goal each: 0, 1 and 5 cm beside each other where they are aligned, so nowhere apart.
    apart = [Demonstration.from_samples([*one, [-0.1, 0.0]], [0.0, 1.0, 2.0]) for one in rows]
    shown = align(apart)
    monkeypatch.setattr(compared, "RIVALS", Registry("rival", {"recaller": Entry(lambda some, _: Recaller(some))}))
    monkeypatch.setattr(paths, "SAMPLES", 100)
    options = ShapingOptions(neurons=(2,))
    shaped = ShapedMotion.fit(shown, options=options)
    network, recaller = compare_models(shown, shaped, rivals=["recaller"], starts=3)[0]
    assert network.model == "lieednn-shaped"
    assert recaller.training.rms_mm == pytest.approx(0.0, abs=0.05)
    # Each by its nearest: 0.01 by 0, 0 by 0.01, 0.05 by 0.01.
    starts = shown.twists[:, 0, 4]
    wanted = [abs(starts[k] - min(np.delete(starts, k), key=lambda y, k=k: abs(y - starts[k]))) for k in range(3)]
    assert recaller.left_out.frechet_mm == pytest.approx(1e3 * np.mean(wanted), rel=1e-2)


def test_a_set_that_fails_is_named_and_not_tried_again_and_other_settings_are_refused(tmp_path, capsys):
    (tmp_path / "lasa").mkdir()
    (tmp_path / "lasa/Broken.mat").write_text("none")
    words = [str(tmp_path), "--output", str(tmp_path / "out"), "--starts"]
    main([*words, "3"])
    said = capsys.readouterr().out
    assert "Broken.mat: " in said
    main([*words, "3"])
    again = capsys.readouterr().out
    assert again in said
    assert f"Not fitted: {tmp_path}/lasa/Broken.mat." in again
    with pytest.raises(FileError, match="was made with mm, 3, and mm, 4 is asked for"):
        main([*words, "4"])
