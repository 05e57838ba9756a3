"""What a large scene asks of the linear algebra: a sparse inverse, and how many threads it may take."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from numpy.typing import NDArray

Solve = Callable[[NDArray], NDArray]


def factorised(matrix: Any, **how: Any) -> Solve | None:
    """x -> matrix^-1 x; None where there is no inverse. ``how``: as for scipy's ``splu``."""
    from scipy.sparse import linalg

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            solve: Solve = linalg.splu(matrix.tocsc(), **how).solve
        except RuntimeError:
            return None
    return solve


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
