"""A video that is written, reopened and looked at."""

import contextlib
import re
import subprocess
import threading

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.budget import reporting
from lieednn_sim.errors import FileError, InputError, RenderingUnavailableError
from lieednn_sim.planning import CertifiedOptions, plan
from lieednn_sim.rendering import opengl, video
from lieednn_sim.rendering.camera import Camera
from lieednn_sim.simulation import simulate


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture(scope="module")
def rollout(arm):
    return simulate(
        arm, plan(arm, arm.keyframe("extended"), options=CertifiedOptions(n_networks=3), duration=2.0).motion, hold=0.5
    )


@pytest.mark.rendering
def test_the_video_has_the_frames_rate_and_size_and_the_arm_moves(arm, rollout, tmp_path):
    path, seen = tmp_path / "video.mp4", []
    with reporting(lambda *done: seen.append(done)):
        count = video.render_video(rollout, path, size=(320, 180), fps=4, preset="draft")
    assert count == 11
    assert seen[-1] == (11, 11)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    read = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    assert re.search(rb"Video: h264.* yuv420p.*, 320x180.*, 4 fps", read.stderr)
    assert imageio_ffmpeg.count_frames_and_secs(path) == (11, 2.75)
    frames = np.frombuffer(read.stdout, np.uint8).reshape(11, 180, 320, 3).astype(float)
    change = [np.abs(frame - frames[0]).mean() for frame in frames]
    assert change[5] > 1.0, "half way the arm has moved"
    assert change[8] > change[2], "and it goes on moving"
    assert np.abs(frames[-1] - frames[-2]).mean() < 0.3, "during the hold it rests"
    assert frames[0].std() > 20, "the picture is not blank"
    assert list(tmp_path.iterdir()) == [path], "no temporary file is left"


@pytest.mark.rendering
def test_the_planned_path_is_drawn_over_the_arm(arm, rollout):
    """Where the arm is before it, too, of which the pixels of its own points say."""
    overlay = video.Overlay(arm.link_poses(rollout.q_ref).as_matrix(), rollout.link_position[:, -1])
    points, turned = arm.link_poses(rollout.q[0]).translation, rollout.q[0] + np.eye(8)[0]
    with Camera(arm, size=(320, 180), preset="draft") as camera:
        picture = camera.picture(rollout.q[0])
        (pixels, free), (lines, planned, *_) = camera.seen(points), overlay.paths(camera.seen, 0, 180)[0]
        moved = np.abs(camera.picture(turned).astype(int) - picture).max(axis=-1) > 20
    # Frames are inside of links, which are where the picture changes when the arm turns.
    assert moved[tuple(pixels[1:, ::-1].astype(int).T)].all()
    assert not free[1:].any()
    assert 0.5 < planned.mean() <= 1.0
    drawn = video.draw_lines(picture, overlay.paths(lambda _: (lines, planned), 0, 180))
    assert (np.abs(drawn.astype(int) - picture).max(axis=-1) > 40).sum() > 30


@pytest.fixture
def encoding(arm, tmp_path, monkeypatch):
    """A function that makes a video with a function in place of the encoder; events say which pictures were rendered.

    Frame k is grey, of brightness k, and too small for words.
    """
    rendered = [threading.Event() for _ in range(6)]
    moving = make_rollout(arm, arm.keyframe("home") + np.linspace(0.0, 0.1, 251)[:, None])

    class Pictures(contextlib.nullcontext):
        scale = 1.0

        def seen(self, points):
            return np.full((len(points), 2), np.nan), np.zeros(len(points), bool)

        def picture_at(self, qpos, draw):
            k = sum(event.is_set() for event in rendered)
            rendered[k].set()
            return np.full((90, 160, 3), k, np.uint8)

    def make(append, rollout=moving):
        monkeypatch.setattr(video, "Camera", lambda *_, **__: Pictures())
        writer = contextlib.nullcontext(lambda picture: append(picture[0, 0, 0]))
        monkeypatch.setattr(video, "_writer", lambda path, *_: path.touch() or writer)
        monkeypatch.setattr(video, "_check_complete", lambda *_: None)
        return video.render_video(rollout, tmp_path / "video.mp4", fps=2)

    return make, rendered


def test_a_picture_is_encoded_while_the_next_is_rendered(encoding):
    (make, rendered), written = encoding, []

    def append(k):
        assert rendered[min(k + 1, 5)].wait(20.0), "the next picture waits for this one"
        written.append(k)

    assert make(append) == 6
    assert written == list(range(6))


def test_what_rests_is_not_rendered_again(encoding, arm):
    """Two pictures of a second of motion, and one of two seconds at rest."""
    (make, _), written = encoding, []
    q = arm.keyframe("home") + 0.1 * np.clip(np.arange(301) / 100.0, 0.0, 1.0)[:, None]
    assert make(written.append, make_rollout(arm, q)) == 7
    assert written == [0, 1, 2, 2, 2, 2, 2]


@pytest.mark.parametrize("frame", [0, 3, 5])
def test_what_the_encoder_says_ends_the_rendering_and_no_file_is_left(encoding, tmp_path, frame):
    make, rendered = encoding

    def append(k):
        if k == frame:
            raise FileError("the disk is full")

    with pytest.raises(FileError, match="the disk is full"):
        make(append)
    assert sum(event.is_set() for event in rendered) <= frame + 2, "no picture is rendered for nothing"
    assert list(tmp_path.iterdir()) == []


def test_bad_input_is_refused_before_rendering(arm, rollout, tmp_path):
    with pytest.raises(InputError, match=r"\.mp4 or \.gif"):
        video.render_video(rollout, tmp_path / "video.avi")
    with pytest.raises(InputError, match=r"GIFs count in hundredths of a second.*got 30"):
        video.render_video(rollout, tmp_path / "video.gif", fps=30)
    with pytest.raises(InputError, match=r"no camera 'moon'; allowed: .*overview"):
        video.render_video(rollout, tmp_path / "video.mp4", camera="moon")
    with pytest.raises(InputError, match="no preset 'ugly'; allowed: draft, nice"):
        video.render_video(rollout, tmp_path / "video.mp4", preset="ugly")
    with pytest.raises(InputError, match="even and at most 3840x2160, got 321x180"):
        video.render_video(rollout, tmp_path / "video.mp4", size=(321, 180))
    for size in (320, (320,), "640x480", None):
        with pytest.raises(InputError, match=r"size must be a tuple of 2, each item a whole number, got "):
            video.render_video(rollout, tmp_path / "video.mp4", size=size)


def test_without_opengl_the_error_names_the_packages(arm, rollout, tmp_path, monkeypatch):
    def missing():
        raise RenderingUnavailableError("install libegl1 libgl1")

    monkeypatch.setattr(opengl, "require", missing)
    with pytest.raises(RenderingUnavailableError, match="libegl1"):
        video.render_video(rollout, tmp_path / "video.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [1, 10], ids=["at the end", "on the way"])
def test_a_full_disk_is_an_error_with_the_encoders_words(tmp_path, count):
    path = tmp_path / "v.mp4"
    path.symlink_to("/dev/full")
    pictures = np.random.default_rng(0).integers(0, 255, (count, 90, 160, 3), np.uint8)

    def write():
        with video.mp4_writer(path, (160, 90), 10.0) as append:
            for picture in pictures:
                append(picture)

    with pytest.raises(FileError, match=r"cannot write the video, the encoder stopped \(.*No space left on device"):
        write()


def test_frames_are_counted(tmp_path):
    path = tmp_path / "v.mp4"
    with video.mp4_writer(path, (160, 90), 10.0) as append:
        for grey in (20, 90, 160, 230):
            append(np.full((90, 160, 3), grey, np.uint8))
    video._check_complete(path, 4)
    (tmp_path / "junk.mp4").write_bytes(b"junk")
    with pytest.raises(FileError, match="0 of 4 frames arrived"):
        video._check_complete(tmp_path / "junk.mp4", 4)


def test_a_second_of_frames_lasts_a_second(tmp_path):
    pictures = np.random.default_rng(0).integers(0, 255, (25, 16, 16, 3), dtype=np.uint8)
    for name in ("v.mp4", "v.gif"):
        with video._writer(tmp_path / name, (16, 16), 25) as append:
            for picture in pictures:
                append(picture)
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4")) == (25, pytest.approx(1.0, abs=0.02))
    with Image.open(tmp_path / "v.gif") as film:
        durations = []
        for k in range(film.n_frames):
            film.seek(k)
            durations.append(film.info["duration"])
    assert durations == [40] * 25


def test_a_gif_has_the_legend_s_colours(tmp_path):
    """A film of noise needs more than 256 colours; the legend's few pixels keep theirs in every frame."""
    noise = np.random.default_rng(0).integers(0, 255, (3, 200, 400, 3), dtype=np.uint8)
    with video._writer(tmp_path / "v.gif", (400, 200), 25) as append:
        for picture in noise:
            append(video.write_caption(picture, ["words"]))
    with Image.open(tmp_path / "v.gif") as film:
        for k in range(3):
            film.seek(k)
            shown = np.asarray(film.convert("RGB"))[:80, :250]
            for colour, _ in video.KEY:
                assert (shown == colour).all(axis=-1).sum() > 10
