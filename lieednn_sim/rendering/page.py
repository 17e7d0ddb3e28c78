"""Pages that show a motion in 3D: one HTML file that opens without a network, to play, scrub and turn."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable
from html import escape
from pathlib import Path

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.registry import optional_module
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.overlay import KEY
from lieednn_sim.rendering.recording import record
from lieednn_sim.rendering.video import check_camera
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_path

__all__ = ["render_page"]

# viser's player fills the window below a caption, and on narrow screens is no higher than what it shows is wide.
_STYLE = """<style>
body { display: flex; flex-direction: column; background: #fff; color: #1c1f23; }
header { display: flex; flex-wrap: wrap; gap: .1rem 1.2rem; padding: .55rem .9rem; font-size: .92rem; }
header i { display: inline-block; width: 1.3em; height: .3em; margin-right: .45em; vertical-align: .18em; }
#root { flex: 1; min-height: 0; max-height: calc(100vw / RATIO + 3rem); }
@media (prefers-color-scheme: dark) { body { background: #1a1b1e; color: #e6e8ea; } }
</style>"""


def player(recording: str, *, title: str = "Motion", style: str = "", header: str = "") -> str:
    """A page with viser's player.

    Args:
        recording: a recording in base64, or what a script replaces by one.
        title: the page's title.
        style: HTML for its head.
        header: HTML above the player.

    Raises:
        LieEDNNError: viser is not installed.
    """
    viser = optional_module("viser")
    page = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text("utf-8")
    # The two names are how viser's own pages give their player a recording; see `viser.infra.StateSerializer.as_html`.
    given = (
        f'<script>window.__VISER_EMBED_DATA__="{recording}";window.__VISER_EMBED_CONFIG__='
        '{darkMode:matchMedia("(prefers-color-scheme: dark)").matches};</script>'
    )
    page = page.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    # viser's notice of slow rendering without a graphics card would cover the arm.
    player_style = "<style>.mantine-Notifications-root { display: none; }</style>"
    page = page.replace("</head>", f"{given}{player_style}{style}</head>", 1)
    return page.replace('<div id="root">', f'{header}<div id="root">', 1)


def render_page(
    rollout: Rollout,
    path: str | os.PathLike[str],
    *,
    camera: str | None = None,
    title: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a page that plays a rollout in 3D, with a timeline and a camera that the mouse moves.

    It shows the arm in its scene, the target, the planned path and the path travelled so far, and a caption. It opens
    as a file, asks for nothing from the network, and follows the reader's choice of light or dark.

    Args:
        rollout: the rollout.
        path: ``.html`` file.
        camera: the view it begins with, as for `render_video`.
        title: the planner's name, for the caption.
        progress: called with (done, total) after every recorded instant.

    Raises:
        InputError: the name does not end in .html, or there is no such camera.
        LieEDNNError: viser, of the extra ``view``, is not installed.
    """
    if as_path("path", path).suffix != ".html":
        raise InputError(f"a page's name must end in .html, got {Path(path).name!r}")
    check_camera(rollout.arm, camera)
    recording = record([rollout], camera=camera, progress=progress)
    texts = [f"<b>{escape(scene_setup.place(rollout.arm))}</b>"]
    texts += [escape(word) for word in (title, rollout.controller, _duration(rollout)) if word]
    for (red, green, blue, _), word in KEY:
        colour = f"rgb({255 * red:.0f} {255 * green:.0f} {255 * blue:.0f})"
        texts.append(f'<i style="background:{colour}"></i>{word} path')
    page = player(
        base64.b64encode(recording.content).decode("ascii"),
        title=f"{title or 'Motion'} on {scene_setup.place(rollout.arm)}",
        style=_STYLE.replace("RATIO", f"{recording.ratio:.3f}"),
        header="<header>" + "".join(f"<span>{text}</span>" for text in texts) + "</header>",
    )
    with io.atomic_text(path) as stream:
        stream.write(page)


def _duration(rollout: Rollout) -> str:
    held = rollout.hold
    return f"{rollout.motion_end:.2f} s" + (f", then {held:.2f} s at rest" if held > 0.005 else "")


typecheck_public(globals())
