"""`view`, and the page that it opens: a server for browsers, and the thread that shows a session in it."""

from __future__ import annotations

import contextlib
import ipaddress
import threading
import time
import warnings
import webbrowser
from typing import Any

from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target, goes_to_extended
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.live.panel import Panel
from lieednn_sim.live.scene import ArmScene, Observer
from lieednn_sim.live.session import Session
from lieednn_sim.live.settings import Settings
from lieednn_sim.registry import optional_module
from lieednn_sim.rendering.viser_server import quiet_server
from lieednn_sim.validation import Seed, as_count, as_seed
from lieednn_sim.values import Floats

# Instants shown per second, and how many of them pass between two updates of tables and plots.
_RATE, _TABLE = 30.0, 5
# A drag of the target without a message for this long is over, for example after a lost connection [s].
_DRAG_ENDS = 1.0


class Page(contextlib.AbstractContextManager["Page"]):
    """A session that is shown in the browser; `close` ends it, as does the end of a ``with`` block.

    Args:
        session: the session; the page runs it, and closes it.
        host, port: as for `view`, but without a warning.

    Attributes:
        url: the page's address.

    Raises:
        LieEDNNError: viser, of the extra ``view``, is not installed.
    """

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int = 0) -> None:
        self.session, self._closed, self._resources = session, threading.Event(), contextlib.ExitStack()
        server = quiet_server(host, as_count("port", port, 0, 65535))
        self._server: Any = self._resources.enter_context(server)
        shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        self.url = f"http://{shown}:{self._server.get_port()}"
        self._scene = ArmScene(self._server, session.arm, session.aimed)
        self._panel = Panel(self._server, session, self._scene)
        self._dragged = -_DRAG_ENDS
        self._scene.handle.on_update(self._drag)
        for node, body in self._scene.surfaces:
            node.on_drag("left")(self._grab(body))
        self._observer = Observer(session)
        self._thread = threading.Thread(target=self._show, name="page", daemon=True)
        session.run()
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> bool:
        """Open the page in a browser; False if there is none."""
        with contextlib.suppress(webbrowser.Error):
            return webbrowser.open(self.url)
        return False

    def wait(self) -> None:
        """Wait until `close` is called, or until Ctrl-C."""
        # Waiting for an event without a time limit would not notice Ctrl-C on every platform.
        while not self._closed.wait(1.0):
            pass

    def close(self) -> None:
        """Close the page and the session."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.session.close()
        self._thread.join()
        self._resources.close()

    async def _drag(self, event: Any) -> None:
        # Async, since calls in the server's pool of threads may change their order, also that of the last two.
        self._dragged = time.monotonic() if event.phase != "end" else -_DRAG_ENDS
        target = event.target
        turn = Rotation.from_quat(target.wxyz, scalar_first=True) if self._panel.direction_counts.value else None
        if event.phase != "start":
            self.session.aim(target.position.copy(), turn)

    def _grab(self, body: str) -> Any:
        async def pull(event: Any) -> None:
            force = self._panel.spring(event.start_position, event.end_position)
            self.session.pull(body, force if event.phase != "end" else (0.0, 0.0, 0.0), event.start_position)

        return pull

    def _show(self) -> None:
        aimed, count = self.session.aimed, 0
        while not self._closed.wait(1.0 / _RATE):
            snapshot = self._observer.look()
            with self._server.atomic():
                self._scene.show(snapshot, self.session.path)
                if snapshot.aimed is not aimed and time.monotonic() - self._dragged > _DRAG_ENDS:
                    aimed = snapshot.aimed
                    self._scene.handle.position, self._scene.handle.wxyz = aimed.position, aimed.quaternion
                if count % _TABLE == 0:
                    self._panel.show(snapshot)
            count += 1


def warning(host: str) -> str:
    """A warning about an address that other machines can reach; empty for the loopback address."""
    try:
        private = ipaddress.ip_address(host).is_loopback
    except ValueError:
        private = host == "localhost"
    return "" if private else f"anybody who can reach this machine at {host} can see the page and move its arm"


def view(
    arm: Arm | str = "telescopic_pr",
    *,
    target: ArrayLike | str | None = None,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    host: str = "127.0.0.1",
    port: int = 0,
    browser: bool = True,
    **settings: Any,
) -> Page:
    """Show a simulated arm in the browser: drag its target, push its links, change policy, controller and load.

    ``with ls.view("telescopic_pr") as page: page.wait()`` shows it until Ctrl-C.

    Args:
        arm: an arm in its scene, or what `Arm.load` takes.
        target: ``(n,)`` the first joint target, or a keyframe's name; by default ``extended``, or a random one among
            obstacles or where there is no such keyframe.
        start: ``(n,)`` joint coordinates at the beginning, or a keyframe's name.
        seed: seed of random draws.
        host: address to listen at; any but the loopback address admits other machines, with a warning.
        port: port to listen at; 0 for a free one.
        browser: whether to open the page in a browser, if there is one.
        settings: fields of `Settings`, such as ``policy`` and ``payload``.

    Returns:
        The page, which runs until it is closed.

    Raises:
        InputError: a value is malformed or unknown, or the controller cannot drive the arm.
        LieEDNNError: viser, of the extra ``view``, or the planner's library is not installed.
    """
    optional_module("mjviser.conversions")  # fails now, not after the work, if it is missing
    shown = arm if isinstance(arm, Arm) else Arm.load(arm)
    chosen = Settings().changed(**settings)
    first = _usual_target(shown, as_seed("seed", seed)) if target is None else target
    session = Session(shown, settings=chosen, target=first, start=start, seed=seed)
    if said := warning(host):
        warnings.warn(said, stacklevel=2)
    try:
        page = Page(session, host=host, port=port)
    except BaseException:
        session.close()
        raise
    if browser:
        page.open()
    return page


def _usual_target(arm: Arm, seed: int) -> Floats | str:
    with contextlib.suppress(NoSolutionError):
        return "extended" if goes_to_extended(arm) else draw_target(arm, seed)
    return "home"
