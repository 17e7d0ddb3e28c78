"""The instants that a video's frames show, and for how long; no OpenGL needed."""

import contextlib
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from rollouts import make_rollout

from lieednn_sim.rendering import video


def rollout_of(arm, steps):
    """A rollout with steps of 0.01 s, whose first coordinate is their number."""
    q = np.zeros((steps, 4))
    q[:, 0] = np.arange(steps)
    return make_rollout(arm, q)


@pytest.mark.parametrize(
    ("fps", "steps", "shown"),
    [
        (10, 51, [0, 10, 20, 30, 40, 50]),
        (25, 22, [0, 4, 8, 12, 16, 20]),
        # Every third of a second, to the nearest step.
        (30, 12, [0, 3, 7, 10]),
    ],
)
def test_frame_k_is_of_the_time_k_over_the_rate(gantry, monkeypatch, tmp_path, fps, steps, shown):
    seen, written = [], []

    class Camera(contextlib.nullcontext):
        def __init__(self, arm, **options):
            super().__init__(self)
            assert (options["target"] == target).all()

        def picture(self, q, draw):
            seen.append((q[0], draw.keywords["k"]))
            return np.zeros((2, 2, 3), dtype=np.uint8)

    @contextlib.contextmanager
    def writer(path, size, rate):
        written.append(rate)
        path.touch()
        yield lambda image: None

    target = np.full(4, 0.125)
    monkeypatch.setattr(video, "Camera", Camera)
    monkeypatch.setattr(video, "_writer", writer)
    monkeypatch.setattr(video, "_check_complete", lambda *_: None)
    count = video.render_video(replace(rollout_of(gantry, steps), target=target), tmp_path / "v.mp4", fps=fps)
    # What is shown and what is drawn over it are of the same instant.
    assert seen == [(k, k) for k in shown]
    assert count == len(shown)
    assert written == [fps]


@pytest.mark.parametrize("fps", [10, 25])
def test_a_second_of_frames_lasts_a_second(tmp_path, fps):
    pictures = np.random.default_rng(0).integers(0, 255, (fps, 16, 16, 3), dtype=np.uint8)
    for name in ("v.mp4", "v.gif"):
        with video._writer(tmp_path / name, (16, 16), fps) as append:
            for picture in pictures:
                append(picture)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4"))
    assert frames == fps
    assert seconds == pytest.approx(1.0, abs=0.02)
    with Image.open(tmp_path / "v.gif") as film:
        durations = []
        for k in range(film.n_frames):
            film.seek(k)
            durations.append(film.info["duration"])
    assert durations == [1000 / fps] * fps
