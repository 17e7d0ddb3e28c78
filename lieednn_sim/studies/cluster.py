"""A Dask cluster as an executor; needs the extra ``cluster``."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.versions import versions

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
        yield DaskExecutor(client)


class DaskExecutor(Executor):
    """Runs tasks on the workers of a client.

    The name of a task is a hash of its inputs and of the code. On a worker with another version of the code it ends
    with `BrokenExecutor`, which stops all the work.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._executor = client, client.get_executor()
        self._versions, self._run = versions(code=True), _runner()

    @property
    def n_workers(self) -> int:
        """The present number of workers."""
        return len(self._client.nthreads())

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """See `Executor.submit`."""
        task = pickle.dumps((function, arguments, named))
        digest = hashlib.sha256(repr(self._versions).encode() + task).hexdigest()
        return self._executor.submit(self._run, self._versions, task, key=f"lieednn_sim-{digest}")


def _runner() -> Callable[[dict[str, str], bytes], Any]:
    # A local function is pickled by value: it also runs where there is another version of the package, or none.
    def run(wanted: dict[str, str], task: bytes) -> Any:
        import pickle
        import socket
        from concurrent.futures import BrokenExecutor

        from distributed import get_worker

        where = f"the worker {get_worker().address} on {socket.gethostname()}"
        if get_worker().state.nthreads != 1:
            raise BrokenExecutor(f"{where} has several threads; start workers with --nthreads 1")
        try:
            from lieednn_sim.versions import versions

            found = versions(code=True)
            function, arguments, named = pickle.loads(task)
        except Exception as error:
            raise BrokenExecutor(f"{where} has another lieednn_sim, or none ({error!r})") from None
        if found != wanted:
            differ = [
                f"{name} {found.get(name)}, here {wanted[name]}" for name in wanted if found.get(name) != wanted[name]
            ]
            raise BrokenExecutor(f"{where} has {'; '.join(differ)}")
        return function(*arguments, **named)

    return run
