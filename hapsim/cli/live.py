"""The live line: one line on standard error that says what is going on, and only where somebody can see it change."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status

from hapsim.cli.output import JsonLog, json_log
from hapsim.number_format import plural

if TYPE_CHECKING:
    from hapsim.progress import Progress

_MOST_CHANNELS = 4
_STEP_S = 5.0  # between two lines where the output is no terminal


@contextlib.contextmanager
def live_line(error: Console) -> Iterator[Callable[[Progress], None]]:
    """A function to tell progress to. On a terminal one line changes in place; elsewhere a line comes now and then."""
    log = json_log()
    if log is not None:
        yield _Logged(log).tell
        return
    with live_words(error) as say:
        yield _Line(say).tell


@contextlib.contextmanager
def live_words(error: Console) -> Iterator[Callable[[str], None]]:
    """The same for whoever has words of his own; the first of them says of what kind they are."""
    if error.is_terminal:
        with error.status("starting") as status:
            yield lambda text: _update(status, text)
    else:
        yield _Spoken(error).say


def _update(status: Status, text: str) -> None:
    status.update(text)


class _Spoken:
    """Says a text when it is new in kind or the last one is a while ago."""

    def __init__(self, error: Console) -> None:
        self._error = error
        self._last = -_STEP_S
        self._kind = ""

    def say(self, text: str) -> None:
        now, kind = time.monotonic(), text.split(" ", 1)[0]
        if kind != self._kind or now - self._last >= _STEP_S:
            self._error.print(text, soft_wrap=True)
            self._last, self._kind = now, kind


class _Logged:
    """Progress as lines of a log: when its phase is another, and now and then; the event is the phase."""

    def __init__(self, log: JsonLog) -> None:
        self._log = log
        self._text = ""
        self._line = _Line(self._take)
        self._last, self._phase = -_STEP_S, ""

    def tell(self, progress: Progress) -> None:
        """Logs it, unless the last one is only just written."""
        self._line.tell(progress)
        now = time.monotonic()
        if progress.phase != self._phase or now - self._last >= _STEP_S:
            self._last, self._phase = now, progress.phase
            fields = asdict(progress) if progress.phase == "running" else {"text": progress.text}
            self._log.say("info", progress.phase, self._text, **fields)

    def _take(self, text: str) -> None:
        self._text = text


class _Line:
    """Progress, as a line of text."""

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._compiled = 0
        self._since = time.monotonic()

    def tell(self, progress: Progress) -> None:
        """Shows how it is doing now."""
        if progress.phase == "compiling":
            if not self._compiled:
                self._since = time.monotonic()
            self._compiled += 1
            far = "" if progress.share is None else f"{100.0 * progress.share:.0f} %, "
            elapsed = time.monotonic() - self._since
            self._show(f"compiling, once on this machine: {far}{plural(self._compiled, 'function')} in {elapsed:.0f} s")
            return
        self._compiled = 0
        if progress.phase == "waiting":
            self._show(f"waiting for {progress.text} · Ctrl-C ends the run")
            return
        if progress.phase == "serving":
            self._show(f"serving the mock device at {progress.text} · Ctrl-C stops it")
            return
        moved = zip(progress.position[:_MOST_CHANNELS], progress.force, strict=False)
        # + 0.0: no minus before a zero
        felt = ", ".join(f"{round(1e3 * x, 2) + 0.0:+.2f} mm {round(f, 3) + 0.0:+.3f} N" for x, f in moved)
        rate = "" if progress.seen_rate_hz is None else f" · {progress.seen_rate_hz:.1f} Hz"
        limited = f" · {progress.limited_ticks} at the limit" if progress.limited_ticks else ""
        known = zip(progress.estimated_mass_kg, progress.estimated_mass_uncertainty_kg, strict=True)
        mass = " ".join(f"{kg:.3g} ± {unsure:.1g}" for kg, unsure in known if kg is not None)
        mass = f" · mass {mass} kg" if mass else ""
        slewed = f" · {progress.slewed_ticks} slewed" if progress.slewed_ticks else ""
        slowed = f" · {progress.slowed_ticks} with changes slowed" if progress.slowed_ticks else ""
        faded = f" · {progress.faded_ticks} outside the travel" if progress.faded_ticks else ""
        self._show(
            f"running {progress.elapsed_s:.1f} s{rate} · {felt} · "
            f"age {progress.age_samples} · misses {progress.deadline_misses}{limited}{slewed}{slowed}{faded}{mass}"
        )
