"""Videos and pictures of rollouts, rendered headlessly and streamed to disk."""

from __future__ import annotations

import contextlib
import functools
import itertools
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image as Picture

from lieednn_sim.budget import report
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import atomic_path
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.camera import PRESETS, Camera, Image
from lieednn_sim.rendering.overlay import KEY, Line, Overlay, draw_lines, write_caption
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_path, as_positive
from lieednn_sim.values import StrPath

__all__ = ["PRESETS", "Camera", "render_video"]

_PLAIN = Picture.Dither.NONE
_STILL = 1e-5  # a frame that differs by less [m, rad] is not rendered again: rendering takes nearly all of the time
_MAX_RATE = 1000.0  # frames per second: more is probably a mistake


def check_rate(fps: float, path: StrPath) -> float:
    """Return the frame rate, or raise `InputError` when it is out of range or a GIF cannot hold it."""
    rate = as_positive("fps", fps)
    if rate > _MAX_RATE:
        raise InputError(f"fps must be at most {_MAX_RATE:g}, got {rate:g}")
    if Path(path).suffix == ".gif" and (rate > 50.0 or 100.0 % rate):
        raise InputError(f"GIFs count in hundredths of a second; fps must be 50, 25, 20, 10, 5 ..., got {rate:g}")
    return rate


def render_video(
    rollout: Rollout,
    path: StrPath,
    *,
    camera: str | None = None,
    size: tuple[int, int] = (1280, 720),
    fps: int = 25,
    preset: str = "nice",
    title: str = "",
) -> int:
    """Render a video of a rollout, with planned link frames, and the paths of the end effector and of a hanging load.

    Frame k shows the time k / fps. A caption in a corner has the time, the names of arm, scene and controller, the
    proved clearance at that time, and a colour legend; in a sequence it names the step. The model of a view is shown as
    it is, with everything that moves.

    Args:
        rollout: the rollout, whose target the marker shows.
        path: ``.mp4`` or ``.gif``; it appears only when the video is complete.
        camera: a camera of the scene, see `Camera` (default: overview, if there is one, else a view of everything).
        size: (width, height) in pixels.
        fps: frames per second of simulated time.
        preset: ``draft``, which is faster, or ``nice``.
        title: first line of the caption, such as the planner's name.

    Returns:
        The number of frames.
    """
    if as_path("path", path).suffix not in (".mp4", ".gif"):
        raise InputError(f"a video's name must end in .mp4 or .gif, got {Path(path).name!r}")
    rate = check_rate(fps, path)
    # The slack keeps the last frame when duration * fps is a whole number up to rounding.
    total = int(np.floor((rollout.t[-1] - rollout.t[0]) * rate + 1e-6)) + 1
    samples = np.rint(np.arange(total) / rate / rollout.timestep).astype(int)
    names, end = [title] if title else [], rollout.t[-1]
    view = Camera(rollout.arm, camera=camera, size=size, preset=preset, run=rollout)
    overlay = Overlay.of(rollout, view.scale)
    with view, atomic_path(path) as temporary:
        # A picture is captioned and encoded while the next one is rendered.
        with _writer(temporary, size, rate) as append, ThreadPoolExecutor(1) as encoder:

            def write(picture: Image, paths: list[Line], now: float) -> None:
                words = [*names, *scene_setup.caption(rollout, now), f"{now:.2f} s of {end:.2f} s"]
                append(write_caption(draw_lines(picture, paths), words, bool(len(overlay.traced_load))))

            written: Future[None] | None = None
            shown = np.array([np.inf])
            for done, k in enumerate(samples, start=1):
                now = np.append(rollout.qpos[k], rollout.q_ref[k])
                if np.abs(now - shown).max() > _STILL:
                    picture, shown = view.picture_at(rollout.qpos[k], functools.partial(overlay.draw, k=int(k))), now
                paths = overlay.paths(view.seen, int(k), size[1])
                if written is not None:
                    written.result()
                written = encoder.submit(write, picture, paths, rollout.t[k])
                if done == total:
                    written.result()
                report(done, total)
        _check_complete(temporary, total)
    return total


def _check_complete(path: Path, total: int) -> None:
    """Check that a video is readable: a disk that fills up with the last frame goes unnoticed by the encoder."""
    if path.suffix == ".mp4":
        frames = 0
        with contextlib.suppress(OSError, RuntimeError):
            frames = int(imageio_ffmpeg.count_frames_and_secs(str(path))[0])
        if frames != total:
            raise FileError(f"cannot write the video: {frames} of {total} frames arrived; is the disk full?")


@contextlib.contextmanager
def _writer(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    if path.suffix == ".mp4":
        with mp4_writer(path, size, fps) as append:
            yield append
        return
    pictures: list[Picture.Image] = []

    def add(image: Image) -> None:
        frame = Picture.fromarray(image)
        pictures.append(_with_key(frame) if not pictures else frame.quantize(palette=pictures[0], dither=_PLAIN))

    yield add
    pictures[0].save(path, format="GIF", save_all=True, append_images=pictures[1:], duration=1000.0 / fps, loop=0)


def _with_key(frame: Picture.Image) -> Picture.Image:
    """A frame in 256 colours, the legend's among them, which are too rare in the frame to be chosen otherwise."""
    palette = frame.quantize(256 - len(KEY))
    others = (palette.getpalette() or [])[: 3 * (256 - len(KEY))]
    palette.putpalette([*others, *itertools.chain(*(colour for colour, _ in KEY))])
    return frame.quantize(palette=palette, dither=_PLAIN)


@contextlib.contextmanager
def mp4_writer(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    """Yield a function that appends an RGB picture ``(height, width, 3)``; the file is complete after the block.

    An existing file is overwritten, and a failing block leaves it unfinished. Width and height must be even. ffmpeg is
    a child process that always ends, with its pipes closed, when the block does: imageio's own writer and reader leave
    a stopped one running, and its reader gives up after ten seconds, which a busy machine may need. `FileError` if the
    encoder stopped; the message has its first line of output.
    """
    width, height = size
    command = ["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    command += ["-r", str(Fraction(fps).limit_denominator()), "-i", "-", "-an"]
    crf = 10  # constant rate factor of H.264, 0 to 51: nearly lossless
    command += ["-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", str(crf), "-preset", "veryfast"]
    command += ["-movflags", "+faststart", str(path)]
    with tempfile.TemporaryFile() as words:
        streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": words}
        try:
            # In its own session, so that Ctrl-C does not reach it.
            encoder = subprocess.Popen([imageio_ffmpeg.get_ffmpeg_exe(), *command], start_new_session=True, **streams)
        except (OSError, RuntimeError) as error:
            raise FileError(
                f"cannot run ffmpeg: {error}; unset IMAGEIO_FFMPEG_EXE to use the bundled one, or write a .gif"
            ) from None
        assert encoder.stdin is not None
        frames = encoder.stdin

        def stopped() -> FileError:
            words.seek(0)
            lines = words.read().decode(errors="replace").strip().splitlines()
            reason = lines[0] if lines else f"status {encoder.wait()}"
            return FileError(f"cannot write the video, the encoder stopped ({reason}); is the disk full?")

        def append(picture: Image) -> None:
            try:
                frames.write(np.ascontiguousarray(picture).data)
            except OSError:  # on Windows not a broken pipe, but an invalid argument
                encoder.wait()
                raise stopped() from None

        try:
            yield append
            with contextlib.suppress(OSError):
                frames.close()
            if encoder.wait() != 0:
                raise stopped()
        finally:
            encoder.kill()
            encoder.wait()
            with contextlib.suppress(OSError):
                frames.close()


typecheck_public(globals())
