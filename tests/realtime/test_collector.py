"""No garbage collection while it lasts, and afterwards exactly what there was."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from hapsim.loop.realtime.memory import collector_frozen as frozen


class Ring:
    """Refers to itself, so that only the collector finds it."""

    def __init__(self, freed: list[bool]) -> None:
        self.itself, self.freed = self, freed

    def __del__(self) -> None:
        self.freed.append(True)


@pytest.fixture(autouse=True)
def _as_it_was() -> Iterator[None]:
    yield
    gc.unfreeze()
    gc.enable()


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("was_frozen", [True, False])
def test_nothing_is_collected_while_it_lasts_and_afterwards_all_is_as_it_was(enabled: bool, was_frozen: bool) -> None:
    if was_frozen:
        gc.freeze()
    if not enabled:
        gc.disable()
    before = gc.get_freeze_count()
    made_since: list[list[int]] = [[] for _ in range(1000)]
    with frozen(1) as grant:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert grant.granted
    assert gc.isenabled() is enabled
    assert (gc.get_freeze_count() > 0) is was_frozen
    assert gc.get_freeze_count() < before + len(made_since), "nothing was added to what somebody else set aside"


def test_garbage_is_collected_before_the_rest_is_set_aside() -> None:
    gc.disable()
    freed: list[bool] = []
    Ring(freed)
    assert not freed
    with frozen(1):
        assert freed == [True]
