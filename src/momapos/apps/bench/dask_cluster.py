"""Run jobs on a Dask cluster through its executor interface."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from momapos.core import InputError, require

CONNECT_TIMEOUT = 10.0
"""Time to wait for a scheduler [s]."""


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to a Dask scheduler.

    Args:
        address: Address of the scheduler, such as tcp://192.168.0.1:8786.

    Yields:
        The executor, and the number of jobs that it runs in parallel.

    Raises:
        MissingExtraError: dask.distributed is not installed.
        InputError: No scheduler answers, or it has no workers.
    """
    with require("bench"):
        from distributed import Client
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"scheduler {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "start one with 'dask scheduler'"
        ) from error
    with client:
        width = sum(client.nthreads().values())
        if not width:
            raise InputError(
                f"scheduler {address}: it has no workers; start some with 'dask worker {address}'"
            )
        executor = client.get_executor(pure=False)
        try:
            yield executor, width
        finally:
            executor.shutdown(wait=False)
