"""Devices that answer no push, or stop to: that proves nothing of what is judged by their motion."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hapsim.bringup.probe import Leave, judge, steps_of
from hapsim.cli.probe import show_judgement

GENTLE = Leave(force=0.5, travel=0.005, mass=0.2)
NewBench = Callable[..., Any]


def change(bench: Any, kind: str, since: int) -> None:
    """Changes the device after this many positions: its sensor or its motor dies, or works only then, or it is held."""
    device, sent, kept = bench.device, [0], list[Any]()
    send, move = device.send_position, device.move

    def send_position(answer: int) -> None:
        bodies = device.bodies
        if kind == ("sensor dies" if sent[0] >= since else "sensor wakes"):
            kept[:] = kept or [type(body)(x=body.x) for body in bodies]
            device.bodies = kept
        send(answer)
        device.bodies = bodies
        sent[0] += 1

    def moved(now: float) -> None:
        output = device.output
        if kind == ("motor dies" if sent[0] >= since else "motor wakes"):
            device.output = [0.0] * device.channels
        if kind == "is held" and sent[0] >= since:
            device.moved_at = now
        move(now)
        device.output = output

    device.send_position, device.move = send_position, moved


def failed(bench: Any) -> list[str]:
    """Returns the checks that the pushes fail. No division by nothing is passed over."""
    with np.errstate(all="raise"):
        judgement = judge(bench.wire, leave=GENTLE, steps=steps_of(("push",), None))
    assert judgement.released
    return [f"{check.name}: {check.found}" for check in judgement.failed]


@pytest.mark.parametrize(
    "options",
    [{"motors": [[0.0]]}, {"motors": [[1e-4]]}, {"scale": 0.004}, {"bodies": [{"mass": 1e9}]}],
    ids=["a motor that is off", "a weak motor", "a count", "a handle that stays"],
)
def test_a_device_that_does_not_answer_fails_nothing(new_bench: NewBench, options: dict[str, Any]) -> None:
    assert not failed(new_bench(**options))


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("kind", ["sensor dies", "sensor wakes", "motor dies", "motor wakes", "is held"])
def test_a_device_that_stops_to_answer_or_begins_late_fails_nothing(new_bench: NewBench, kind: str) -> None:
    for since in (100, 320, 400, 540, 760):
        bench = new_bench()
        change(bench, kind, since)
        assert not failed(bench), since


@pytest.mark.parametrize("since", [0, 30])
def test_an_acceleration_that_does_not_answer_is_named_so(new_bench: NewBench, since: int) -> None:
    (found,) = failed(new_bench(accelerates=True, stuck_at=since))
    assert found.startswith("acceleration: ")
    assert "it does not answer the pushes" in found
    assert "older than one force" not in found


def test_samples_that_repeat_a_number_show_no_rate(new_bench: NewBench) -> None:
    bench = new_bench()
    device, send = bench.device, bench.device.send_position
    repeated = set()

    def send_position(answer: int) -> None:
        send(answer)
        if device.n % 50 == 49 and device.n not in repeated:
            repeated.add(device.n)
            device.n -= 1

    device.send_position = send_position
    with np.errstate(all="raise"):
        checks = {one.name: one for one in judge(bench.wire, steps=steps_of(("arming",), None)).checks}
    assert checks["numbers"].result == "FAIL"
    assert checks["rate_kept"].result == checks["jitter"].result == "not seen"


def test_a_reason_is_printed_once(new_bench: NewBench) -> None:
    out = Console(file=StringIO(), width=10_000)
    show_judgement(out, judge(new_bench("frozen").wire, leave=GENTLE, steps=steps_of(("push",), None)))
    said = " ".join(out.file.getvalue().split())  # type: ignore[attr-defined]
    assert said.count("sensor or cable?") == 1
