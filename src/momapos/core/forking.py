"""Renew locks in a forked child, which has no copy of the threads that may hold them."""

from __future__ import annotations

import os
import sys
import threading
from functools import cached_property


def fork_safe_lock() -> threading.Lock:
    """Return a lock for which a fork waits, so that it is free in the child.

    The holder must not wait for another such lock, nor fork.
    """
    lock = threading.Lock()
    os.register_at_fork(
        before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
    )
    return lock


def renew_property_locks() -> None:
    """Replace the locks of all cached properties of momapos.

    Up to Python 3.11 a cached property holds a lock while its value is computed. A child that is
    forked meanwhile would wait for it forever.
    """
    modules = [m for name, m in sys.modules.items() if name.partition(".")[0] == "momapos"]
    for module in modules:
        for kind in vars(module).values():
            if isinstance(kind, type) and kind.__module__ == module.__name__:
                for member in vars(kind).values():
                    if isinstance(member, cached_property) and hasattr(member, "lock"):
                        member.lock = threading.RLock()


os.register_at_fork(after_in_child=renew_property_locks)
