"""Display of a running scene: the live line on standard error, and the options that serve it to other programs."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.cli.command_options import chosen_cache, flag, names, option
from hapsim.cli.output import json_log, output_units, print_message, warn
from hapsim.errors import UsageError
from hapsim.number_format import plural
from hapsim.stopping import note_work
from hapsim.units import Units

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.cli.command_options import DeviceOptions
    from hapsim.device.open_connection import TransportKind
    from hapsim.live.access import Address
    from hapsim.live.hub import Hub
    from hapsim.live.server import View
    from hapsim.loop.counts import Progress
    from hapsim.scene import Scene


_MOST_CHANNELS = 4
_STEP_S = 5.0  # between two lines of a kind, where the output is no terminal


@contextlib.contextmanager
def live_line(
    error: Console, warn_not_cached: bool = True, served: str = "the mock device"
) -> Iterator[Callable[[Progress], None]]:
    """Yields a function that shows a Progress: in place on a terminal, elsewhere now and then as a line or in the
    log. At the end, `warn_not_cached` warns if something was compiled that could not be kept, or not where the user
    wants it."""
    words = _Words(served)
    with _shown(error, words) as show_progress:
        yield show_progress
    if warn_not_cached and words.compiled and (problem := _kept().why_not_kept()):
        warn(not_cached(problem), "unkept")
    elif warn_not_cached and "numba" in sys.modules:
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


def not_cached(problem: str) -> str:
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
        """Logs the progress, if it is due."""
        text = words.of(progress)
        event = "running" if progress.phase == "ended" else progress.phase  # its end is an event of its own
        if is_due(event):
            fields = asdict(progress) if event == "running" else {"text": progress.text}
            log.write("info", event, text, **fields)

    yield write


@contextlib.contextmanager
def live_words(error: Console) -> Iterator[Callable[[str], None]]:
    """Yields a function that shows a text in the same way. The first word of a text is its kind."""
    if _can_change_a_line(error):
        with error.status("starting") as status:
            yield status.update
        return
    is_due = _Pace()

    def write(text: str) -> None:
        """Prints the text, if it is due."""
        if is_due(text.split(" ", 1)[0]):
            error.print(text, soft_wrap=True)

    yield write


@contextlib.contextmanager
def at_work(error: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Shows on a terminal what takes its time, and yields a function that shows another text. A stop then says that it
    ended this."""
    note_work(f"while {text}")
    with live_words(error) if error.is_terminal else contextlib.nullcontext(lambda _: None) as show:
        show(text)
        yield show


def _can_change_a_line(error: Console) -> bool:
    return error.is_terminal and not error.is_dumb_terminal  # rich shows nothing of a status where TERM=dumb


class _Pace:
    """Limits the rate of lines: returns True for another kind than the last one, or after an interval; for compiling
    once."""

    def __init__(self) -> None:
        self._kind, self._last, self._has_compiled = "", 0.0, False

    def __call__(self, kind: str) -> bool:
        now, compiles = time.monotonic(), kind.startswith("compiling")
        if (compiles and self._has_compiled) or (kind == self._kind and now - self._last < _STEP_S):
            return False
        self._kind, self._last, self._has_compiled = kind, now, self._has_compiled or compiles
        return True


class _Words:
    """A Progress in words. Counts the functions that were compiled, and since when."""

    def __init__(self, served: str) -> None:
        self._compiled, self._since, self._served = 0, 0.0, served
        self.compiled = False
        """True once anything was compiled."""

    def of(self, progress: Progress) -> str:
        """Returns the text for the next Progress of a run."""
        if progress.phase == "compiling":
            if not self._compiled:
                self._since = time.monotonic()
            self._compiled += 1
            self.compiled = True
            once = ", once on this machine" if _kept().directory_of_kept_code() else ""
            if self._compiled == 1:
                return f"compiling{once}"
            share = "" if progress.share is None else f"{100.0 * progress.share:.0f} %, "
            elapsed = time.monotonic() - self._since
            return f"compiling{once}: {share}{plural(self._compiled, 'function')} in {elapsed:.0f} s"
        self._compiled = 0
        if progress.phase == "waiting":
            return f"waiting for {progress.text} · Ctrl-C ends the run"
        if progress.phase == "serving":
            return f"serving {self._served} at {progress.text} · Ctrl-C stops it"
        return words_of_run(progress)


def words_of_run(progress: Progress) -> str:
    """Returns the live line of a running scene."""
    return " · ".join(filter(None, _of_a_run(progress)))


def _of_a_run(progress: Progress) -> Iterator[str]:
    yield f"running {progress.elapsed_s:.1f} s"
    if progress.seen_rate_hz is not None:
        yield f"{progress.seen_rate_hz:.1f} Hz"
    moved = enumerate(zip(progress.position[:_MOST_CHANNELS], progress.force, strict=False))
    yield ", ".join(_position_and_force(output_units(c), x, force) for c, (x, force) in moved)
    yield ", ".join(f"{name.partition('.')[2]} {value}" for name, value in progress.words.items())
    yield f"age {progress.age_samples}"
    yield f"misses {progress.deadline_misses}"
    for what, count in progress.shown("live"):
        yield f"{count} {what}"
    if progress.sound_latency_s is not None:
        yield f"sound {1e3 * progress.sound_latency_s[0]:.1f} ms late, {progress.resampling_ppm or 0.0:+.1f} ppm"
    units, known = output_units(), zip(progress.estimated_mass_kg, progress.estimated_mass_uncertainty_kg, strict=True)
    if masses := " ".join(
        f"{units.number(kg, 'kg', 3)} ± {units.number(unsure, 'kg', 1)}" for kg, unsure in known if kg is not None
    ):
        yield f"mass {units(masses, 'kg')}"


def _position_and_force(units: Units, x: float, force: float) -> str:
    """Returns both, to 0.01 mm or 0.01°, and to 1 mN, 1 mN·m or less."""
    place = 1e-5 if units.name("m") != "°" else 0.01 / units.scaled(1.0, "m")
    weak = 1e-5 if units.is_rotary and units.scaled(1.0, "N") > 1.0 else 1e-3  # mN·m in a file are of a small knob
    return f"{_fixed(units, x, 'mm', place)} {_fixed(units, force, 'N', weak)}"


def _fixed(units: Units, value: float, unit: str, step: float) -> str:
    """Returns a quantity with as many decimals as show a step of this size, in SI units."""
    decimals = max(0, round(-math.log10(units.scaled(step, unit))))
    return units(value, unit, lambda shown: f"{round(shown, decimals) + 0.0:+.{decimals}f}")  # + 0.0: no -0


_PORT, _OSC_PORT = 7470, 7471


@dataclass
class LiveOptions:
    """Access to the scene while it runs."""

    serve: bool = flag("--serve", "Serve a page for browsers and a WebSocket, to this machine only.")
    serve_at: str | None = option(
        "HOST:PORT", "Address of page and WebSocket. Other machines need the printed token [default: 127.0.0.1:7470]"
    )
    record_dir: Path | None = option("DIR", "Directory for records started from the page [default: no recording]")
    save: bool = flag("--save", "Let pages and WebSockets on other machines save the scene, too.")
    osc: bool = flag("--osc", "Answer OSC over UDP and OSCQuery over TCP, for this machine only.")
    osc_at: str | None = option("HOST:PORT", "Address for OSC and OSCQuery [default: 127.0.0.1:7471]")
    osc_from: list[str] | None = option("IP,…", "Addresses whose OSC is accepted. Required if --osc-at is not local.")
    serve_device: str | None = option(
        "NAME", "Of several devices, the one that page, WebSocket and OSC show [default: the leader]"
    )
    lsl: str | None = option("NAME", "Stream samples and events to Lab Streaming Layer under this name.")

    def transport_kind(self, device: DeviceOptions, scene: Scene) -> TransportKind:
        """Returns the TransportKind of a run: what is served on the mock is for a person, in real time."""
        kind: TransportKind = device.kind()
        devices = scene.devices.values() if scene.ports else (scene.device,)
        is_mock = kind == "mock" or (kind == "auto" and all(one.port is None for one in devices))
        return "paced" if is_mock and (self.serves_page or self.osc or self.osc_at or self.lsl) else kind

    @property
    def serves_page(self) -> bool:
        """True if the page is served."""
        return self.serve or self.serve_at is not None

    @contextlib.contextmanager
    def serving(self, scene: Scene, name: str, idle_priority: bool) -> Iterator[Hub | None]:
        """Serves the scene in the with-block as the options request. Yields the hub that the run keeps up to date; None
        if nothing is requested. `name`: of the scene. `idle_priority`: the loop is compiled. Raises UsageError."""
        page, osc = self._addresses()
        if page is None and osc is None:
            yield None
            return
        import importlib.util

        for package in ("websockets", "pythonosc"):
            if importlib.util.find_spec(package) is None:
                raise UsageError(
                    f"--serve and --osc: found no Python package {package}, expected it: pip install 'hapsim[live]'"
                )
        from hapsim.live.hub import Hub
        from hapsim.live.server import Server

        hub = Hub(scene, self.record_dir, name)
        views = self._views(hub, page, osc)
        server = Server(views, _warn, idle_priority)
        server.start()
        try:
            for view in views:
                print_message(f"{view.WHAT}: {view.url}", "serving", "info", url=view.url)
            yield hub
        finally:
            server.close()

    def words(self) -> list[str]:
        """Returns the options as a command has them. Raises UsageError where they contradict each other."""
        self._addresses()
        words = ["--serve"] * self.serve + ["--save"] * self.save + ["--osc"] * self.osc
        given = ("--serve-at", self.serve_at), ("--osc-at", self.osc_at), ("--osc-from", ",".join(names(self.osc_from)))
        others = ("--lsl", self.lsl), ("--record-dir", self.record_dir and os.path.abspath(self.record_dir))
        for name, value in (*given, *others):
            words += [name, str(value)] if value else []
        return words

    def _views(self, hub: Hub, page: Address | None, osc: Address | None) -> list[View]:
        views: list[View] = []
        if page is not None:
            from hapsim.live.web import WebView

            views.append(WebView(hub, page, _warn, self.save))
        if osc is not None:
            from hapsim.live.osc import OscView
            from hapsim.live.osc_query import OscQueryView

            view = OscView(hub, osc, tuple(names(self.osc_from)), _warn)
            views += [view, OscQueryView(view)]
        return views

    def _addresses(self) -> tuple[Address | None, Address | None]:
        """Returns the addresses of the page and of OSC; None if not served. Raises UsageError."""
        serves, answers_osc = self.serves_page, self.osc or self.osc_at is not None
        if self.save and not serves:
            raise UsageError("--save needs --serve-at: other machines save from its page")
        if self.record_dir is not None and not serves:
            raise UsageError("--record-dir needs --serve: records are started from its page")
        if self.record_dir is not None and not self.record_dir.is_dir():
            raise UsageError(f"--record-dir {self.record_dir}: no such directory")
        if self.osc_from and not answers_osc:
            raise UsageError("--osc-from needs --osc")
        for one in names(self.osc_from):
            import ipaddress

            try:
                ipaddress.ip_address(one)
            except ValueError:
                raise UsageError(f"--osc-from: found '{one}', expected an IP address, or several with commas") from None
        if not serves and not answers_osc:
            return None, None
        from hapsim.live.access import address_of

        page = address_of("--serve-at", self.serve_at, _PORT) if serves else None
        osc = address_of("--osc-at", self.osc_at, _OSC_PORT) if answers_osc else None
        if osc is not None and not osc.is_loopback and not self.osc_from:
            raise UsageError(f"--osc-at {osc}: --osc-from is missing: name the addresses whose OSC is accepted")
        return page, osc


def _warn(sentence: str) -> None:
    print_message(sentence, "live", "warning")
