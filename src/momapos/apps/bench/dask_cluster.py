"""Jobs answered by a Dask cluster, whose client is an executor."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from momapos.core import InputError, require

CONNECT = 10.0
"""How long to wait for a scheduler [s]."""


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """The workers of a Dask scheduler.

    Args:
        address: Of the scheduler, as tcp://192.168.0.1:8786.

    Yields:
        The executor, and how many jobs it does at once.

    Raises:
        MissingExtraError: dask.distributed is not installed.
        InputError: There is no scheduler, or it has no workers.
    """
    with require("bench"):
        from distributed import Client
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "start one by 'dask scheduler'"
        ) from error
    try:
        width = sum(client.nthreads().values())
        if not width:
            raise InputError(
                f"--scheduler {address}: the scheduler has no workers; start some by "
                f"'dask worker {address}'"
            )
        executor = client.get_executor(pure=False)
        try:
            yield executor, width
        finally:
            executor.shutdown(wait=False)
    finally:
        client.close()
