"""`view`, which shows an arm in the browser."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target, goes_to_extended
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.live.page import Page, warning
from lieednn_sim.live.playback import Track
from lieednn_sim.live.session import Session
from lieednn_sim.live.settings import Settings
from lieednn_sim.planning import default_planner
from lieednn_sim.rendering import viser_scene
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats


def view(
    arm: Arm | str = "telescopic_pr",
    *,
    policy: str = "lieednn-shaped",
    planner: str | None = None,
    controller: str = "inverse-dynamics",
    payload: float = 0.0,
    mass_scale: float = 1.0,
    rho: float = 1.0,
    filtered: bool | None = None,
    target: ArrayLike | str | None = None,
    start: ArrayLike | str = "home",
    seed: Seed = 0,
    rollouts: Mapping[str, Rollout] | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    dark: bool = False,
    browser: bool = True,
) -> Page:
    """Show a simulated arm in the browser: drag its target, push its links, change policy, controller and load.

    ::

        with ls.view("telescopic_pr") as page:
            page.wait()    # until Ctrl-C

    Args:
        arm: an arm in its scene, or what `Arm.load` takes.
        policy: a name of `POLICIES`.
        planner: a name of `PLANNERS`, for the policies that follow or imitate a motion; by default the
            `default_planner`.
        controller: a name of `CONTROLLERS`.
        payload: mass at the end effector that policy and controller do not know [kg].
        mass_scale: true masses relative to those that the controller knows.
        rho: rate of the clock of ``lieednn-shaped``, see `ShapedOptions`.
        filtered: whether the safety filter is around the policy; by default among obstacles.
        target: ``(n,)`` the first joint target, or a keyframe's name; by default ``extended``, or a random one among
            obstacles or where there is no such keyframe.
        start: ``(n,)`` joint coordinates at the beginning, or a keyframe's name.
        seed: seed of random draws.
        rollouts: up to four rollouts of this arm by their planners' names, to be played on one clock beside it.
        host: address to listen at; any but the loopback address is for others, too, with a warning.
        port: port to listen at; 0 for a free one.
        dark: whether the page is dark at first.
        browser: whether to open the page in a browser, if there is one.

    Returns:
        The page, which runs until it is closed.

    Raises:
        InputError: a value is malformed or unknown, or the controller cannot drive the arm.
        LieEDNNError: viser, of the extra ``view``, is not installed.
    """
    viser_scene.require("viser", "mjviser.conversions")  # before the work
    shown = arm if isinstance(arm, Arm) else Arm.load(arm)
    settings = Settings(
        policy,
        default_planner(shown)[0] if planner is None else planner,
        rho,
        shown.scene != "free" if filtered is None else filtered,
        controller,
        payload,
        mass_scale,
    )
    first = _usual_target(shown, as_seed("seed", seed)) if target is None else target
    session = Session(shown, settings=settings, target=first, start=start, seed=seed)
    if said := warning(host):
        warnings.warn(said, stacklevel=2)
    tracks = [Track.of(name, rollout) for name, rollout in (rollouts or {}).items()]
    try:
        page = Page(session, host=host, port=port, tracks=tracks, dark=dark)
    except BaseException:
        session.close()
        raise
    if browser:
        page.open()
    return page


def _usual_target(arm: Arm, seed: int) -> Floats | str:
    if goes_to_extended(arm):
        return "extended"
    try:
        return draw_target(arm, seed)
    except NoSolutionError:
        return "home"
