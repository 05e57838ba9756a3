"""A thread to ask for, and a system that refuses."""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import pytest


@pytest.fixture(scope="package", autouse=True)
def _little_to_collect() -> Iterator[None]:
    """Sets aside what the tests before left: each collection would search all of it."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def thread_id() -> Iterator[int]:
    """The native id of a thread of this process that waits."""
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    yield thread.native_id
    end.set()
    thread.join()


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], None]:
    """Makes a function, named as in ``os.open``, fail with an error number."""

    def make(function: str, number: int) -> None:
        def fail(*_arguments: Any) -> NoReturn:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(function, fail)

    return make


@pytest.fixture(params=["root", "somebody"])
def root(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """True if the tests appear to run as root."""
    monkeypatch.setattr("os.geteuid", lambda: 0 if request.param == "root" else 1000)
    return bool(request.param == "root")
