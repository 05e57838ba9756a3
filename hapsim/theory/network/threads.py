"""How many threads the linear algebra takes."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any


def one_thread(where: bool = True) -> AbstractContextManager[Any]:
    """One alone, while this is entered: further ones wait for each other, and longer where others run.

    ``where``: False leaves them as they are, and spares the import of scipy.
    """
    if not where:
        return nullcontext()
    import scipy.linalg  # noqa: F401  # it brings a BLAS of its own, which is limited only once it is there
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[Any] = threadpool_limits(1, user_api="blas")
    return limits
