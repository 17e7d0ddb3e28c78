"""What every test needs: OpenGL chosen before MuJoCo, one thread for BLAS, repeatable property tests, a browser.

No test depends on how fast the machine is: those that interrupt a process wait for its own word that it is at work.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from lieednn_sim import budget, registry
from lieednn_sim.rendering import opengl

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lieednn_sim.arm import Arm
    from lieednn_sim.network import LieEDNN

    Floats = NDArray[np.float64]

# Where bytecode is not kept, every process that a test starts compiles the package anew, and every worker the tests.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# One thread: the test workers share the cores, and results don't depend on them. BLAS reads these when it loads, which
# NumPy's has done by now.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
threadpool_limits(1, "blas")

# A software renderer compiles its programs anew for each picture's context; to optimise them takes half of that.
os.environ.setdefault("GALLIVM_PERF", "nopt")

# To wait for the disk makes nothing safer here; `test_platform.py` walks the road with the system's own.
os.fsync = os.fstat

# What is installed beside it and offers Hypothesis something, such as trio, need not be imported by every worker.
os.environ.setdefault("HYPOTHESIS_NO_PLUGINS", "1")

# Garbage is little beside what is imported and kept, so that to look for it often takes a tenth of the time.
gc.set_threshold(100_000, 50, 50)

# No test depends on how fast the machine is: time budgets see a clock that stands still. Tests of them bring their own.
budget.cpu_time = lambda: 0.0

# Seconds after which a file of tests says where it is, and goes on: none takes a tenth of it, and a hang is seen.
_HANGS = 900.0
_running: Path | None = None
_stderr = 2  # behind what pytest captures

# What Windows has not: signals between processes, limits of a process, named pipes, and a shell.
_POSIX = ("cli/test_interruption", "test_ensure_env", "test_faults", "test_reference")
collect_ignore = [f"{name}.py" for name in _POSIX] if sys.platform == "win32" else []

_BACKEND = opengl.configure()
# A skip for want of a marker's means is a failure where its variable is set.
_REQUIRED = {
    marker: variable
    for marker, variable in (("rendering", "LIEEDNN_REQUIRE_RENDERING"), ("browser", "LIEEDNN_REQUIRE_BROWSER"))
    if os.environ.get(variable, "") not in ("", "0")
}

# An arm for numbers by hand: link 1 is at (x, y, z), the end effector 1 m beside it and turned by the angle about z.
# The ranges are 2, 4, 5 and 6; the ball around the end effector has a radius of 0.1 m and is over a floor at -1 m.
_GANTRY = """
<mujoco model="gantry">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.01" integrator="implicitfast"/>
  <custom>
    <numeric name="velocity_limit" data="1 2 4 8"/>
    <numeric name="acceleration_limit" data="10 20 40 80"/>
  </custom>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -1"/>
    <body name="base"><geom size="0.05" mass="1" contype="0" conaffinity="0"/><site name="base_frame"/>
      <body name="carriage" gravcomp="1">
        <joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
        <joint name="y" type="slide" axis="0 1 0" range="-2 2"/>
        <joint name="z" type="slide" axis="0 0 1" range="-2 3"/>
        <geom size="0.05" mass="1" contype="0" conaffinity="0"/>
        <site name="link1_frame"/>
        <body name="wrist" pos="1 0 0" gravcomp="1">
          <joint name="turn" type="hinge" axis="0 0 1" range="-3 3"/>
          <geom name="ball" size="0.1" mass="1"/>
          <site name="link2_frame"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="1000" kv="100" gear="2" forcerange="-30 50"/>
    <position joint="y" kp="1000" kv="100" gear="0.5" forcerange="-50 30"/>
    <position joint="z" kp="1000" kv="100" forcerange="-40 40"/>
    <position joint="turn" kp="1000" kv="100"/>
  </actuator>
  <keyframe><key name="home" qpos="0 0 0 0"/></keyframe>
</mujoco>
"""


# An arm of others, two hinges with a site for its tool.
_TWO_HINGES = """
<mujoco>
  <worldbody>
    <body name="one"><joint name="a" range="-90 90"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      <body name="two" pos="0.3 0 0"><joint name="b" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" size="0.02" fromto="0.05 0 0 0.3 0 0"/><site name="tool" pos="0.3 0 0"/>
      </body></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is gone after it, and the entry points of packages are looked for again."""
    for kind in (registry.PLANNERS, registry.POLICIES, registry.CONTROLLERS):
        monkeypatch.setattr(kind, "entries", dict(kind.entries))
        monkeypatch.setattr(kind, "_searched", False)


@pytest.fixture
def two_hinges() -> str:
    """MJCF of the bodies ``one`` and ``two``; see `_TWO_HINGES`."""
    return _TWO_HINGES


@pytest.fixture(scope="session")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    """Joints x, y, z, turn of two links; see `_GANTRY`."""
    from lieednn_sim.arm import Arm  # not before OpenGL is chosen and BLAS has its threads

    path = tmp_path_factory.mktemp("gantry") / "gantry.xml"
    path.write_text(_GANTRY)
    return Arm.from_xml(path, "gantry")


@pytest.fixture(scope="session")
def cascade() -> Callable[..., LieEDNN]:
    """A network of n visible neurons, two hidden ones and a clock that ends at a target ``(n, 6)``; all by hand.

    The clock p' = -p + tanh(p) / 2 drives the hidden neurons h' = -h + 2 tanh(p) + a, and these the visible ones, with
    strengths of 0.3 and -0.2, or a share of them.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from lieednn_sim.network import LieEDNN

    def make(target: Floats, share: float = 1.0) -> LieEDNN:
        n = len(target)
        alpha = np.zeros((n + 3, n + 3))
        alpha[:n, n], alpha[:n, n + 1] = 0.3 * share, -0.2 * share
        alpha[n : n + 2, n + 2], alpha[n + 2, n + 2] = 2.0, 0.5
        rng = np.random.default_rng(0)
        rotation, translation = np.tile(np.eye(3), (n + 3, n + 3, 1, 1)), np.zeros((n + 3, n + 3, 3))
        rotation[:n, n : n + 2] = Rotation.random(2 * n, rng=rng).as_matrix().reshape(n, 2, 3, 3)
        translation[:n, n : n + 2] = 0.5 * rng.normal(size=(n, 2, 3))
        bias = np.zeros((n + 3, 6))
        bias[n], bias[n + 1] = -0.5, 0.4
        hidden = np.concatenate([bias[n : n + 2] + 1.5, [np.linspace(0.5, 1.5, 6)]])
        network = LieEDNN(alpha, rotation, translation, bias, hidden_start=hidden, n_clock=1)
        return network.retarget(target).certify()

    return make


_save_figure: Callable[..., None] | None = None  # the package's own
_fix_layout: Callable[..., None] | None = None

# A job in the background of a shell inherits that Ctrl-C is ignored, and the commands would respect it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("lieednn", max_examples=20, deadline=None, derandomize=True, print_blob=True)
# For `pytest tests/test_fuzz.py --hypothesis-profile=fuzz`: new examples every time, until something is found.
settings.register_profile("fuzz", deadline=None, max_examples=1_000_000, print_blob=True)
settings.load_profile("lieednn")


# The files whose tests draw with a browser, which takes all that a core has for as long as a page is open.
_BROWSER = ("live/test_page", "rendering/test_page", "studies/report/test_page", "test_browser_page")


def pytest_configure() -> None:
    global _stderr
    _stderr = os.dup(2)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Workers share the tests by files, so that what a file's fixtures make is made once, and start one browser."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            name = nodeid.partition("::")[0].removeprefix("tests/").removesuffix(".py")
            return "browser" if name in _BROWSER else name

    return ByFile(config, log) if config.getoption("dist") == "load" else None


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector need not look through it again and again.

    And figures are composed, but neither laid out nor drawn, which is matplotlib's and takes longer than most tests.
    Of an imported arm a few straight paths are looked along, where a test does not ask for more.
    """
    from lieednn_sim.arm.importer import remarks
    from lieednn_sim.evaluation import figure_layout

    remarks._PATHS = 16

    global _save_figure, _fix_layout
    _save_figure, _fix_layout = figure_layout.save_figure, figure_layout.fix_layout
    figure_layout.save_figure = lambda _, path: Path(path).write_bytes(b"a picture")
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a rendering test where nothing can be rendered, and a browser test where there is no browser.

    With a file's first test begins the time after which it hangs; each test's own would take longer than most tests.
    """
    global _running
    if item.path != _running:
        _running = item.path
        faulthandler.dump_traceback_later(_HANGS, file=_stderr)
    if item.get_closest_marker("rendering") and not _BACKEND.renders:
        pytest.skip(f"no headless OpenGL: {_BACKEND.detail}")
    if item.get_closest_marker("browser"):
        missing = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
        if missing:
            pytest.skip(f"no {' and no '.join(missing)}; scripts/ensure_browser.sh installs them")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn the skip of a test into a failure when what it needs is required, whoever skipped it."""
    report = yield
    report.keywords = {}  # nobody reads them, and to tell them from process to process takes long
    if report.skipped and not hasattr(report, "wasxfail"):
        for marker, variable in _REQUIRED.items():
            if item.get_closest_marker(marker):
                reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
                report.outcome = "failed"
                report.longrepr = f"{variable} is set, so this must not be skipped.\n{reason}"
    return report


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless Chromium that draws with the processor and logs what pages say and ask for; see `opened`."""
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    # To draw smooth edges takes a processor longer than all else.
    options.add_argument("--webgl-antialiasing-mode=none")
    # So does compiling a page's code for speed, which runs for a second or two.
    options.add_argument("--js-flags=--no-opt")
    # Nor does it connect on a guess: a server that closes waits for who has connected and asks for nothing.
    options.add_experimental_option("prefs", {"net.network_prediction_options": 2})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    driver.set_script_timeout(300)
    try:
        yield driver
    finally:
        driver.quit()


@pytest.fixture(scope="module")
def opened(chromium: Any) -> Iterator[Callable[[str, int, int], Any]]:
    """A function that opens an address in a window of a width and a height, without the logs of other pages.

    Unless it is the address opened last: tests of a page go on with it, whatever their order. After the module's tests
    no page is left, which would be drawn for ever.
    """
    last = None

    def opened(address: str, width: int, height: int) -> Any:
        nonlocal last
        if address == last:
            return chromium
        last = address
        chromium.get("about:blank")
        for log in ("browser", "performance"):
            chromium.get_log(log)
        chromium.set_window_size(width, height)
        chromium.get(address)
        return chromium

    yield opened
    chromium.get("about:blank")


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn, see `pytest_collection_finish`, but not laid out, unless a test asks for `laid_out`, too."""
    from lieednn_sim.evaluation import figure_layout

    monkeypatch.setattr(figure_layout, "save_figure", _save_figure)
    monkeypatch.setattr(figure_layout, "fix_layout", lambda figure, _: figure.set_layout_engine(None))


@pytest.fixture
def laid_out(monkeypatch: pytest.MonkeyPatch, drawing: None) -> None:
    """Figures are laid out before they are drawn."""
    from lieednn_sim.evaluation import figure_layout

    monkeypatch.setattr(figure_layout, "fix_layout", _fix_layout)


@pytest.fixture
def no_plots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots are not even composed, though their files are there.

    For tests in which plots are by the way; `test_cli.test_the_demo_without_video_meets_its_bounds` draws them.
    """
    from lieednn_sim.evaluation import plots

    for what in ("network", "tracking", "joints", "clearance", "channels", "training"):
        monkeypatch.setattr(plots, f"plot_{what}", lambda *given, **_: Path(given[-1]).write_bytes(b"a picture"))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of comparisons hold the rows that a figure would show in its place; for tests of everything else in them.

    `studies/report/test_page.py` and `cli/test_compare.py` draw them.
    """
    from lieednn_sim.studies.report import figures, page

    monkeypatch.setattr(page, "plots", lambda rows, controller: [figures.Plot(controller, repr(rows), "")])


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a Python process from its arguments; at the end of the test it is gone, and its pipes are closed.

    It may be interrupted, though a shell starts what runs in its background with interrupts ignored, and children
    inherit that.
    """
    with contextlib.ExitStack() as stack:

        def begin(*arguments: str, **options: object) -> subprocess.Popen[str]:
            usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
            if sys.platform != "win32":
                usual["preexec_fn"] = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
            process = stack.enter_context(subprocess.Popen([sys.executable, *arguments], **{**usual, **options}))
            stack.callback(process.kill)
            return process

        yield begin
