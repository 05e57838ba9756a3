"""What `hapsim probe` shows: on a terminal, and as a JSON document."""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console

from hapsim.cli.live import live_words

if TYPE_CHECKING:
    from hapsim.bringup.probe import Check, Judgement

_STYLE = {"pass": "green", "FAIL": "bold red", "not seen": "yellow"}
_INDENT = " " * 10


@contextlib.contextmanager
def step_line(error: Console) -> Iterator[Callable[[str, int, int], None]]:
    """A function to tell each step to: its name, its number, and of how many."""
    with live_words(error) as say:
        yield lambda step, number, of: say(f"{step}: step {number} of {of}")


def show_judgement(out: Console, judgement: Judgement) -> None:
    """Every check by its step, and what it comes to."""
    device = judgement.device
    if device is not None:
        words = f"{device.channels} channel{'s' if device.channels > 1 else ''}, {device.rate_hz:g} Hz"
        _print(out, "", f"{judgement.port}: '{device.name}', {words}", "bold")
    step = ""
    for check in judgement.checks:
        if check.step != step:
            step = check.step
            _print(out, "", f"\n{step}", "bold")
        _show_check(out, check)
    out.print()
    _print(out, "", _conclusion(judgement))


def _show_check(out: Console, check: Check) -> None:
    name = f"{check.name} (§ {check.section})"
    out.print(f"{check.result:<10}", style=_STYLE[check.result], end="")
    lines = textwrap.wrap(f"{name}: {check.found}", _width(out) - len(_INDENT), break_long_words=False)
    out.print(f"\n{_INDENT}".join(lines), markup=False, soft_wrap=True)
    if check.result == "FAIL":
        _print(out, "expected: ", check.expected)
    if check.look_at:
        _print(out, "look at:  ", check.look_at)


def _width(out: Console) -> int:
    return max(min(out.width, 120), 40)


def _print(out: Console, label: str, text: str, style: str = "") -> None:
    indent = _INDENT + label if label else ""
    hanging = " " * len(indent)
    for line in text.split("\n"):
        wrapped = textwrap.fill(
            line, _width(out), initial_indent=indent, subsequent_indent=hanging, break_long_words=False
        )
        out.print(wrapped, markup=False, soft_wrap=True, style=style)


def _conclusion(judgement: Judgement) -> str:
    count = {result: sum(check.result == result for check in judgement.checks) for result in _STYLE}
    told = f"{count['pass']} passed, {count['FAIL']} failed, {count['not seen']} not seen."
    if judgement.failed:
        told += f" Begin with {judgement.failed[0].name}: what comes after it may follow from it."
    if judgement.ended:
        told += f" It ended early: {judgement.ended}."
    if not judgement.released:
        told += " The device did not say that it is idle: take its power, before you trust its force to be zero."
    return told


def judgement_document(judgement: Judgement) -> dict[str, Any]:
    """What `hapsim probe --json` prints."""
    return {
        "port": judgement.port,
        "device": None if judgement.device is None else asdict(judgement.device),
        "checks": [asdict(check) for check in judgement.checks],
        "passed": sum(check.result == "pass" for check in judgement.checks),
        "failed": len(judgement.failed),
        "not_seen": sum(check.result == "not seen" for check in judgement.checks),
        "released": judgement.released,
        "ended_early": judgement.ended or None,
        "exit_status": judgement.exit_status,
    }
