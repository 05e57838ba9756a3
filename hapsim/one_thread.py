"""Linear algebra on one thread: for small matrices, several threads wait for each other, and take twice the time."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any


def one_thread(where: bool = True) -> AbstractContextManager[Any]:
    """Returns a context in which numpy's and scipy's linear algebra uses one thread; empty if not `where`."""
    if not where:
        return nullcontext()
    libraries = _libraries("scipy.linalg" in sys.modules)
    limits: AbstractContextManager[Any] = libraries.limit(limits=1, user_api="blas")
    return limits


@cache
def _libraries(_with_scipy: bool) -> Any:
    """Found once, and again once scipy has loaded its own: a look through all that is loaded takes a millisecond."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
