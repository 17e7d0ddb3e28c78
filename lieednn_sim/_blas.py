"""One BLAS thread for small matrices: threads slow them down many times, and the digits then depend on the machine."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from threadpoolctl import ThreadpoolController

_CONTROLLER = ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread."""
    return _CONTROLLER.limit(limits=1, user_api="blas")
