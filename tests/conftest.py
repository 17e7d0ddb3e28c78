"""What every test needs: OpenGL chosen before MuJoCo, one thread for BLAS, and repeatable property tests."""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest
from hypothesis import settings

from lieednn_sim import opengl

# NumPy's BLAS reads this when it loads. One thread: the test workers share the cores, and results don't depend on them.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

_BACKEND = opengl.configure()
_REQUIRE_RENDERING = os.environ.get("LIEEDNN_REQUIRE_RENDERING", "") not in ("", "0")

settings.register_profile("lieednn", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("lieednn")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a rendering test where nothing can be rendered."""
    if item.get_closest_marker("rendering") and not _BACKEND.renders:
        pytest.skip(f"no headless OpenGL: {_BACKEND.detail}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn the skip of a rendering test into a failure when LIEEDNN_REQUIRE_RENDERING is set, whoever skipped it."""
    report = yield
    if (
        _REQUIRE_RENDERING
        and report.skipped
        and not hasattr(report, "wasxfail")
        and item.get_closest_marker("rendering")
    ):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"LIEEDNN_REQUIRE_RENDERING is set, so this must not be skipped.\n{reason}"
    return report
