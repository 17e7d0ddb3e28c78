"""MP4 files through ffmpeg, as a child process that always ends, with its pipes closed, when the work does.

imageio's own writer and reader leave a stopped ffmpeg running and its pipes open, and its reader gives up after ten
seconds, which a busy machine may need.
"""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError


@contextlib.contextmanager
def mp4_writer(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """Yield a function that appends an RGB picture ``(height, width, 3)``; the file is complete after the block.

    An existing file is overwritten, and a failing block leaves it unfinished. Width and height must be even.

    Raises:
        FileError: the encoder stopped; the message has its first line of output.
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

        def append(picture: NDArray[np.uint8]) -> None:
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


def count_frames(path: Path) -> int:
    """Number of readable frames of a video; 0 if it cannot be read."""
    try:
        return int(imageio_ffmpeg.count_frames_and_secs(str(path))[0])
    except (OSError, RuntimeError):
        return 0
