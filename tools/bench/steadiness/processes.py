"""Processes of the benchmark: each dies with it, whatever ends it, and runs under the conditions of its peers."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29
_SLACK_NS = 1
_prctl = ctypes.CDLL(None).prctl
_PATIENCE_S = 60.0  # beyond the time that a measurement takes: interpreters start, code is loaded


class PeerError(Exception):
    """A peer did not do what it was asked to. What it said is in the text."""


@contextlib.contextmanager
def running(
    command: Sequence[str], environment: Mapping[str, str] | None = None, cpus: Iterable[int] = ()
) -> Iterator[subprocess.Popen[str]]:
    """A process that is gone when the with-block is left. Sleeps end on time in it; `cpus`: it stays on
    one of them."""
    # Set here, a child is born with it. Set by the child itself, it would be lost on its first way back from SCHED_FIFO
    # to ordinary scheduling, which is how cyclictest begins.
    _prctl(_PR_SET_TIMERSLACK, _SLACK_NS, 0, 0, 0)
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **(environment or {})},
        preexec_fn=_in_child(cpus),  # noqa: PLW1509 (this process has one thread)
    )
    try:
        yield process
    finally:
        end(process)


def end(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Asks a process to end, and sees to it; what it said last."""
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    with contextlib.suppress(ValueError):  # its pipes are closed: it has ended before
        try:
            return process.communicate(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.communicate()
    return "", ""


def answer_of(
    command: Sequence[str],
    seconds: float,
    environment: Mapping[str, str] | None = None,
    cpus: Iterable[int] = (),
) -> str:
    """Returns the output of a program that runs for `seconds`. Raises PeerError if it fails or does not end."""
    with running(command, environment, cpus) as process:
        try:
            out, err = process.communicate(timeout=seconds + _PATIENCE_S)
        except subprocess.TimeoutExpired as error:
            raise PeerError(f"{' '.join(command[:4])}: no answer within {seconds + _PATIENCE_S:.0f} s") from error
    if process.returncode != 0:
        last_words = " / ".join(err.strip().splitlines()[-3:])
        raise PeerError(f"{' '.join(command[:4])}: exit status {process.returncode}: {last_words}")
    return out


def json_of(command: Sequence[str], seconds: float, **conditions: Any) -> dict[str, Any]:
    """The JSON document that a program prints as its last line."""
    out = answer_of(command, seconds, **conditions)
    try:
        document: dict[str, Any] = json.loads(out.strip().splitlines()[-1])
    except (IndexError, ValueError) as error:
        raise PeerError(f"{' '.join(command[:4])}: found {out[-200:]!r}, expected a JSON document") from error
    return document


def python(job: Mapping[str, Any]) -> list[str]:
    """The command that does `job` in a Python process of its own (peer.py)."""
    return [sys.executable, "-m", "steadiness.peer", json.dumps(job)]


def _in_child(cpus: Iterable[int]) -> Callable[[], None]:
    """Returns the function that a child runs before it becomes the program."""

    def prepare() -> None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if cpus:
            os.sched_setaffinity(0, cpus)

    return prepare
