"""What every test needs: OpenGL chosen before MuJoCo, one thread for BLAS, repeatable property tests, a browser.

No test depends on how fast the machine is: those that interrupt a process wait for its own word that it is at work.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator

import pytest
from hypothesis import settings

from lieednn_sim import opengl

# NumPy's BLAS reads this when it loads. One thread: the test workers share the cores, and results don't depend on them.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

_BACKEND = opengl.configure()
# A skip for want of a marker's means is a failure where its variable is set.
_REQUIRED = {
    marker: variable
    for marker, variable in (("rendering", "LIEEDNN_REQUIRE_RENDERING"), ("browser", "LIEEDNN_REQUIRE_BROWSER"))
    if os.environ.get(variable, "") not in ("", "0")
}

settings.register_profile("lieednn", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("lieednn")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a rendering test where nothing can be rendered, and a browser test where there is no browser."""
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
    if report.skipped and not hasattr(report, "wasxfail"):
        for marker, variable in _REQUIRED.items():
            if item.get_closest_marker(marker):
                reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
                report.outcome = "failed"
                report.longrepr = f"{variable} is set, so this must not be skipped.\n{reason}"
    return report


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a Python process from its arguments; at the end of the test it is gone, and its pipes are closed."""
    with contextlib.ExitStack() as stack:

        def begin(*arguments: str, **options: object) -> subprocess.Popen[str]:
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
            process = stack.enter_context(subprocess.Popen([sys.executable, *arguments], **{**pipes, **options}))
            stack.callback(process.kill)
            return process

        yield begin
