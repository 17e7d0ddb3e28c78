"""Short videos of chosen cases, small enough to be embedded in a page."""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from lieednn_sim.errors import InputError
from lieednn_sim.rendering.ffmpeg import count_frames, read_frame
from lieednn_sim.rendering.video import render_video
from lieednn_sim.studies.comparison.cases import replay
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.study import settings_of
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import quoted

# Size [pixels] and frame rate [1/s] of clips, and the fraction of a clip at which its poster is taken.
SIZE = (480, 270)
FPS = 25
_POSTER_AT = 0.55
_POSTER_QUALITY = 80


@dataclass(frozen=True)
class Clip:
    """A video of a case.

    Attributes:
        row: its row in the table.
        video: MP4 file.
        poster: JPEG of one of its frames.
    """

    row: Row
    video: bytes
    poster: bytes

    @property
    def data_uri(self) -> str:
        """The video as a data URI."""
        return _uri("video/mp4", self.video)

    @property
    def poster_uri(self) -> str:
        """The poster as a data URI."""
        return _uri("image/jpeg", self.poster)


def film(
    table: Table[Row],
    case: Case,
    controller: str,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Clip:
    """Plan and simulate a case of a table again and render it.

    Raises:
        InputError: the table has no such case, or it has no motion.
        RenderingUnavailableError: there is no working OpenGL.
    """
    row = table.rows.get((case.arm, case.scene, case.planner, controller, case.seed))
    if row is None:
        raise InputError(f"the table has no case {quoted(str(case))} with {quoted(controller)}; compare it first")
    if row.tracking_rms_mm is None:
        raise InputError(f"case {case} has nothing to show: {row.reason}")
    rollout = replay(case, controller, settings_of(table), user_files=table.user_files)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        render_video(rollout, path, size=SIZE, fps=FPS, preset="draft", title=case.planner, progress=progress)
        return Clip(row, path.read_bytes(), _poster(path))


def _poster(path: Path) -> bytes:
    frame = read_frame(path, int(_POSTER_AT * count_frames(path)))
    buffer = io.BytesIO()
    Image.open(io.BytesIO(frame)).save(buffer, format="JPEG", quality=_POSTER_QUALITY)
    return buffer.getvalue()


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
