"""The live line: one line on standard error that says what is going on, where a terminal can show it change."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hapsim.cli.options import chosen_cache
from hapsim.cli.output import json_log, spoken, warn
from hapsim.number_format import plural
from hapsim.stopping import note_work
from hapsim.units import InUnits

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from hapsim.progress import Progress

_MOST_CHANNELS = 4
_STEP_S = 5.0  # between two lines of a kind, where the output is no terminal


@contextlib.contextmanager
def live_line(error: Console, warns_of_unkept: bool = True) -> Iterator[Callable[[Progress], None]]:
    """Yields a function that shows a Progress: in place on a terminal, elsewhere now and then as a line or in the
    log. At the end, `warns_of_unkept` warns if something was compiled that could not be kept, or not where the user
    wants it."""
    words = _Words()
    with _shown(error, words) as tell:
        yield tell
    if warns_of_unkept and words.compiled and (problem := _kept().why_not_kept()):
        warn(unkept(problem), "unkept")
    elif warns_of_unkept and "numba" in sys.modules:
        warn_if_elsewhere(_kept().directory_of_kept_code(found=True))


def warn_if_elsewhere(directory: Path | None) -> bool:
    """Warns, and returns True, if compiled code is in `directory`, but --cache or the environment names another."""
    chosen = chosen_cache()
    if chosen is None or chosen.resolve() == directory:
        return False
    where = f"; it is kept in {directory}" if directory else ""
    warn(
        f"{chosen}: compiled code cannot be kept there{where}. It has to be a directory of yours that only you can "
        "write to",
        "unkept",
    )
    return True


def unkept(problem: str) -> str:
    """Returns the warning that compiled code is not kept."""
    return (
        f"compiled code is not kept, and the next start compiles again: {problem}. Name another directory with "
        "--cache or HAPSIM_CACHE"
    )


def _kept() -> Any:
    from hapsim.compiling import kept  # loads numba, which is loaded once something is compiled

    return kept


@contextlib.contextmanager
def _shown(error: Console, words: _Words) -> Iterator[Callable[[Progress], None]]:
    log = json_log()
    if log is None:
        with live_words(error) as show:
            yield lambda progress: show(words.of(progress))
        return
    is_due = _Pace()

    def write(progress: Progress) -> None:
        text = words.of(progress)
        event = "running" if progress.phase == "ended" else progress.phase  # its end is an event of its own
        if is_due(event):
            fields = asdict(progress) if event == "running" else {"text": progress.text}
            log.say("info", event, text, **fields)

    yield write


@contextlib.contextmanager
def live_words(error: Console) -> Iterator[Callable[[str], None]]:
    """Yields a function that shows a text in the same way. The first word of a text says of which kind it is."""
    if _can_change_a_line(error):
        with error.status("starting") as status:
            yield status.update
        return
    is_due = _Pace()

    def write(text: str) -> None:
        if is_due(text.split(" ", 1)[0]):
            error.print(text, soft_wrap=True)

    yield write


@contextlib.contextmanager
def at_work(error: Console, text: str, in_pipes: bool = False) -> Iterator[Callable[[str], None]]:
    """Shows what takes its time, and yields a function that shows another text: in place on a terminal, as a line every
    five seconds where it cannot. `in_pipes`: also every ten seconds elsewhere. A stop then says that it ended this."""
    note_work(f"while {text}")
    if _can_change_a_line(error) or not (error.is_terminal or in_pipes):
        with error.status(text) as status:  # prints nothing in a pipe
            yield status.update
        return
    texts, over = [text], threading.Event()

    def tell() -> None:
        while not over.wait(_STEP_S if error.is_terminal else 2.0 * _STEP_S):
            error.print(texts[-1], soft_wrap=True)

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield texts.append
    finally:
        over.set()


def _can_change_a_line(error: Console) -> bool:
    return error.is_terminal and not error.is_dumb_terminal  # rich shows nothing of a status where TERM=dumb


class _Pace:
    """Lets pass what is of another kind than the last one, or comes a while after it."""

    def __init__(self) -> None:
        self._kind, self._last = "", 0.0

    def __call__(self, kind: str) -> bool:
        now = time.monotonic()
        if kind == self._kind and now - self._last < _STEP_S:
            return False
        self._kind, self._last = kind, now
        return True


class _Words:
    """A Progress in words. Counts the functions that were compiled, and since when."""

    def __init__(self) -> None:
        self._compiled, self._since = 0, 0.0
        self.compiled = False
        """Whether anything was compiled."""

    def of(self, progress: Progress) -> str:
        """Returns the text for the next Progress of a run."""
        if progress.phase == "compiling":
            if not self._compiled:
                self._since = time.monotonic()
            self._compiled += 1
            self.compiled = True
            once = ", once on this machine" if _kept().directory_of_kept_code() else ""
            share = "" if progress.share is None else f"{100.0 * progress.share:.0f} %, "
            elapsed = time.monotonic() - self._since
            return f"compiling{once}: {share}{plural(self._compiled, 'function')} in {elapsed:.0f} s"
        self._compiled = 0
        if progress.phase == "waiting":
            return f"waiting for {progress.text} · Ctrl-C ends the run"
        if progress.phase == "serving":
            return f"serving the mock device at {progress.text} · Ctrl-C stops it"
        return InUnits(" · ".join(filter(None, _of_a_run(progress))))


def _of_a_run(progress: Progress) -> Iterator[str]:
    yield f"running {progress.elapsed_s:.1f} s"
    if progress.seen_rate_hz is not None:
        yield f"{progress.seen_rate_hz:.1f} Hz"
    moved = enumerate(zip(progress.position[:_MOST_CHANNELS], progress.force, strict=False))
    # + 0.0: no minus before a zero
    words = ((c, f"{round(1e3 * x, 2) + 0.0:+.2f} mm {round(f, 3) + 0.0:+.3f} N") for c, (x, f) in moved)
    yield ", ".join(spoken(channel)(one) for channel, one in words)
    yield f"age {progress.age_samples}"
    yield f"misses {progress.deadline_misses}"
    for what, count in progress.shown("live"):
        yield f"{count} {what}"
    if progress.sound_latency_s is not None:
        yield f"sound {1e3 * progress.sound_latency_s[0]:.1f} ms late, {progress.resampling_ppm or 0.0:+.1f} ppm"
    known = zip(progress.estimated_mass_kg, progress.estimated_mass_uncertainty_kg, strict=True)
    if masses := " ".join(f"{kg:.3g} ± {unsure:.1g}" for kg, unsure in known if kg is not None):
        yield f"mass {masses} kg"
