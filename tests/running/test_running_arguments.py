"""Arguments of a session: numbers of every library are as good as those of Python, and anything else is refused."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.replaying.replay import Record, compare
from hapsim.running import start
from hapsim.running.session import Session
from tests.trial_runs import scene

CALLS: dict[str, Callable[[Session, Any], object]] = {
    "lease": lambda session, it: session.lease(it),
    "fallback": lambda session, it: session.lease(1.0, it),
    "channel": lambda session, it: session.pulse(it, "click", 1.0, 0.01),
    "shape": lambda session, it: session.pulse(0, it, 1.0, 0.01),
    "force": lambda session, it: session.pulse(0, "click", it, 0.01),
    "seconds": lambda session, it: session.pulse(0, "click", 1.0, it),
    "periods": lambda session, it: session.pulse(0, "buzz", 1.0, 0.01, it),
    "number": lambda session, it: session.trial(it),
    "set": lambda session, it: session.trial(1, it),
    "restart": lambda session, it: session.trial(1, restart=it),
    "code": lambda session, it: session.trial(1, code=it),
    "over": lambda session, it: session.trial(1, over=it),
    "output": lambda session, it: session.set({"outputs.code": it}),
}


@pytest.mark.parametrize("wrong", [True, "x", b"x", [[1]], 10**400, object()], ids=lambda one: type(one).__name__)
def test_anything_else_is_refused_in_words(wrong: Any) -> None:
    with start(scene(), keep=False) as session:
        for call in CALLS.values():
            with pytest.raises(UsageError, match=r"found|no such file"):
                call(session, wrong)


def test_a_record_has_what_numpy_counted(tmp_path: Path) -> None:
    with start(scene(), record=tmp_path / "a.trace") as session:
        session.pulse(np.int64(0), "buzz", np.float32(0.5), np.float32(0.05), np.int64(2))
        session.set({"touch": {"stiffness": np.int64(250)}, "outputs": {"code": np.uint8(3)}}, np.float32(0.0))
        session.set({"touch.damping": Decimal("4.5"), "outputs": {}})
        session.trial(np.int64(7), {"touch.stiffness": np.float32(300)}, np.array(["drifter"]), np.int64(9))
        session.lease(np.int64(3))
        session.mark(np.int64(17))  # type: ignore[arg-type]
    record = Record(tmp_path / "a.trace")
    notes = [note for note in record.notes if "tick" in note]
    assert [note["pulse"]["channel"] for note in notes if "pulse" in note] == [0]
    assert [note["trial"] for note in notes if "trial" in note] == [7]
    assert [note["marker"] for note in record.notes if "marker" in note] == ["17"]
    comparison = compare(record, None, None, with_curves=False)
    assert comparison.difference is None
