"""Background jobs for which a control loop does not wait; only the newest waiting job counts."""

from __future__ import annotations

import threading
from collections.abc import Callable

from lieednn_sim.budget import one_blas_thread, reporting


class Superseded(Exception):
    """There is a newer job."""


class Worker:
    """Does jobs one after another in its thread; of the jobs that wait, it does only the newest.

    ``failed`` is called in this thread with any exception of a job other than `Superseded`.
    """

    def __init__(self, name: str, failed: Callable[[Exception], object]) -> None:
        self._failed, self._changed = failed, threading.Condition()
        self._next: Callable[[], object] | None = None
        self._busy = self._closed = False
        # A job may take seconds: it must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Callable[[], object]) -> None:
        """Do a job as soon as the present one ends; it replaces another one that waits."""
        with self._changed:
            self._next = job
            self._changed.notify_all()

    def check(self, *_: object) -> None:
        """Raise `Superseded` if the job's result is no longer wanted; called in jobs, and whenever they report."""
        with self._changed:
            if self._next is not None or self._closed:
                raise Superseded

    @property
    def busy(self) -> bool:
        """Whether there is something to do."""
        with self._changed:
            return self._busy or self._next is not None

    def wait(self) -> None:
        """Wait until there is nothing to do."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not (self._busy or self._next is not None))

    def close(self) -> None:
        """Take no more jobs; the present one ends at its next `check`, or with the process."""
        with self._changed:
            self._closed, self._next = True, None
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._next is not None)
                if self._closed or self._next is None:
                    return
                job, self._next, self._busy = self._next, None, True
            try:
                with reporting(self.check), one_blas_thread():
                    job()
            except Superseded:
                pass
            except Exception as error:
                self._failed(error)
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()
