"""A Dask cluster as an executor; needs the extra ``cluster``."""

from __future__ import annotations

import asyncio
import contextlib
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.versions import commit, versions

# Timeout of the scheduler's first answer [s].
_PATIENCE = 20.0


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[DaskExecutor]:
    """The workers of a Dask scheduler; they need the same version of the package, and one thread each.

    A task whose worker dies is repeated on another one; Dask gives it up after four workers.

    Args:
        address: address of the scheduler, such as ``tcp://host:8786``.

    Raises:
        InputError: Dask is not installed, or there is no scheduler.
    """
    try:
        from distributed import Client, rpc
    except ImportError:
        raise InputError("a cluster needs Dask, which is not installed: pip install 'lieednn_sim[cluster]'") from None

    async def ask() -> None:
        async with rpc(address) as scheduler:
            await scheduler.identity()

    try:
        # A client would wait forever for a server of another kind.
        asyncio.run(asyncio.wait_for(ask(), _PATIENCE))
    except (OSError, ValueError) as error:
        reason = str(error) or f"{_PATIENCE:g} s of silence"
        raise InputError(
            f"no Dask scheduler answers at {address!r} ({reason}); 'dask scheduler' starts one and prints its address, "
            "such as tcp://host:8786"
        ) from None
    with Client(address, set_as_default=False) as client:
        yield DaskExecutor(client.get_executor(pure=False))


class DaskExecutor(Executor):
    """Runs tasks on the workers of a client.

    On a worker with another version of the code a task ends with `BrokenExecutor`, which stops all the work.
    """

    def __init__(self, executor: Any) -> None:
        self._executor, self._run = executor, _runner()
        self._made_with = {**versions(), "commit": commit() or "none"}

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """See `Executor.submit`."""
        return self._executor.submit(self._run, self._made_with, pickle.dumps((function, arguments, named)))


def _runner() -> Callable[[dict[str, str], bytes], Any]:
    # A local function is pickled by value: it also runs where there is another version of the package, or none.
    def run(expected: dict[str, str], task: bytes) -> Any:
        import pickle
        import socket
        from concurrent.futures import BrokenExecutor

        from distributed import get_worker

        where = f"the worker {get_worker().address} on {socket.gethostname()}"
        if get_worker().state.nthreads != 1:
            raise BrokenExecutor(f"{where} has several threads; start workers with --nthreads 1")
        try:
            from lieednn_sim.versions import commit, versions

            here = {**versions(), "commit": commit() or "none"}
            function, arguments, named = pickle.loads(task)
        except Exception as error:
            raise BrokenExecutor(f"{where} has another lieednn_sim, or none ({error!r})") from None
        if differ := [f"{name} {here[name]}, here {expected[name]}" for name in here if here[name] != expected[name]]:
            raise BrokenExecutor(f"{where} has {'; '.join(differ)}")
        return function(*arguments, **named)

    return run
