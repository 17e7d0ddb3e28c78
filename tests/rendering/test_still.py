"""One picture of a whole motion."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.camera import Camera
from lieednn_sim.rendering.still import OPACITIES, instants, render_still


def test_instants_divide_the_path_not_the_time():
    path = np.zeros((6, 3))
    path[:, 0] = [0.0, 0.0, 1.0, 2.0, 4.0, 4.0]
    assert instants(path, 3) == [0, 3, 4]
    assert instants(np.zeros((5, 3)), 3) == [0, 2, 4]


@pytest.mark.rendering
def test_the_arm_is_seen_five_times_and_faded(tmp_path):
    """Pixels of one instant alone are a mix of that instant's picture and of the background behind it."""
    arm, view = Arm.load("telescopic_pr"), {"size": (320, 180), "preset": "draft"}
    home, far = arm.keyframe("home"), arm.keyframe("home").copy()
    far[0] += 2.0  # a turn of the whole arm
    rollout = make_rollout(arm, home + np.linspace(0.0, 1.0, 5)[:, None] * (far - home))
    render_still(rollout, tmp_path / "still.png", **view)
    made = np.asarray(Image.open(tmp_path / "still.png")).astype(float)
    with Camera(arm, target=rollout.target, points=scene_setup.occupied(rollout), **view) as camera:
        pictures = np.array([camera.picture(q) for q in rollout.q]).astype(float)
    background = np.median(pictures, axis=0)
    away = np.abs(pictures - background).max(axis=-1)
    for k, opacity in enumerate(OPACITIES):
        alone = (away[k] > 60.0) & (np.delete(away, k, axis=0).max(axis=0) == 0.0)
        assert np.count_nonzero(alone) > 30
        mixed = np.abs(made - background).max(axis=-1)[alone] / away[k][alone]
        assert np.median(mixed) == pytest.approx(opacity, abs=0.05)


def test_bad_names_are_refused(gantry, tmp_path):
    with pytest.raises(InputError, match=r"must end in \.png, got 'still\.jpg'"):
        render_still(make_rollout(gantry), tmp_path / "still.jpg")
    assert main(["render", str(tmp_path), "--output", str(tmp_path / "still.png")]) == 2
