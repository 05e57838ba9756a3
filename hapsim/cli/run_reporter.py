"""Reports of a run while it goes on, and what is kept of it: one for each device."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hapsim.cli import output
from hapsim.cli.before_arming import print_warnings
from hapsim.cli.output import output_units
from hapsim.device.open_connection import on_device
from hapsim.errors import UsageError
from hapsim.loop.background import BackgroundWork
from hapsim.loop.counts import Progress
from hapsim.prediction import predict
from hapsim.running.reconnecting import RunObserver
from hapsim.running.saving import keep_unsaved
from hapsim.running.session_view import EventKind
from hapsim.running.watch import WatchedFile
from hapsim.scene import Scene
from hapsim.scene.words import words_sentence

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.running import Session

_SENTENCES = ("armed_inside", "frozen", "wrong_sensor")  # of a Progress, printed when they come
_LOOK_S = 0.05  # how often the scene's file is looked at


class RunReporter:
    """Reports the start of a run, and edits of its scene while it runs."""

    def __init__(
        self,
        show: Callable[[Progress], None],
        port: str,
        kind: Any,
        file: WatchedFile | None = None,
        warnings: list[str] | None = None,
        publish: Callable[[EventKind, str], None] = lambda *_: None,
        device: str = "",
    ) -> None:
        """`show`: shows progress. `port`: "" for the mock. `kind`: the TransportKind. `file`: the one to follow.
        `warnings`: those printed already. `publish`: reports an event to the views. `device`: its name, of several."""
        self._show, self._port, self._kind, self._file = show, port, kind, file
        self._warnings, self._publish, self._who = warnings or [], publish, device and f"{device}: "
        self.grants: list[PrivilegeResult] = []
        self._is_placed = False  # whether the position at arming has been looked at
        self._said: set[str] = set()  # what was wrong with a sensor at the last look
        self._session: Session | None = None  # the last one
        self.reported: set[str] = set()
        """The kinds of what was wrong with a sensor at any time."""

    @property
    def observer(self) -> RunObserver:
        """The callbacks of this reporter."""
        return RunObserver(
            arming=self._meet,
            started=self._started,
            running=self._running,
            waiting=lambda: self._show(Progress("waiting", self._port or "the mock")),
            report=lambda event, text: output.print_message(
                text, event, "info" if event == "reconnected" else "warning"
            ),
        )

    def _meet(self, session: Session) -> None:
        """Reports motors that nothing has shown to be right; `on_warning` has it where that lowers a force limit."""
        if session.motors.advice and not session.motors.warning:
            output.print_message(f"{self._who}{session.motors.advice}.", "unknown motor", "info")

    def _started(self, session: Session) -> None:
        """The device is armed. From now on the file is followed, in a thread of its own."""
        self.grants, self._is_placed, self._session = session.grants, False, session
        if (log := output.json_log()) is not None:
            log.write("info", "armed", f"the device is armed; {session.scene.path or 'the scene'} runs")
        for grant in session.grants:
            word = "granted" if grant.granted else "denied"
            sentence = f"{word} {grant.privilege}: {grant.detail}"
            output.print_message(sentence, word, "info" if grant.granted else "warning", **vars(grant))
        if (scene := session.scene).has_words:
            output.print_message(f"digital {words_sentence(scene.inputs, scene.outputs)}", "words", "info")
        if self._file is not None:
            file = self._file
            BackgroundWork(lambda: self._follow(file, session), session.idle_priority)

    def keep_unsaved(self, name: str) -> None:
        """Does `print_unsaved` for the last session."""
        if self._session is not None:
            print_unsaved(self._session.scene, name)

    def _running(self, progress: Progress) -> None:
        """Shows progress. Reports a device that was armed outside its travel, once for each arming, a position that
        stands still while force acts, and a sensed acceleration that contradicts the positions."""
        if progress.phase in ("running", "ended") and progress.ticks > 0 and not self._is_placed:
            self._is_placed = True
            if progress.faded_ticks == progress.ticks:
                units = output_units()
                places = units(", ".join(units.number(one, "m", ".6g") for one in progress.position), "m")
                output.print_message(
                    f"{self._who}the device was armed outside device.travel, at {places}. There the force fades, and "
                    "is zero beyond the band. Move it inside, or set device.origin to its zero",
                    "outside",
                    "warning",
                )
        wrong = {kind: text for kind in _SENTENCES if (text := getattr(progress, kind))}
        for kind in wrong.keys() - self._said:
            output.print_message(f"{self._who}{wrong[kind]}", kind, "warning")
        self._said = set(wrong)
        self.reported |= self._said
        self._show(progress)

    def _follow(self, file: WatchedFile, session: Session) -> None:
        while not session.wait(_LOOK_S):
            news = file.check(session)
            if news is None:
                continue
            if news.refused:
                output.print_message(f"{news.refused}\nThe scene runs on unchanged.", "refused", "warning")
                self._publish("rejected", news.refused)
            for change in news.changed:
                output.print_message(f"changed: {change}", "changed", "info")
            if news.changed:
                scene = on_device(session.scene, self._kind)
                self._warnings = print_warnings(scene, predict(scene, with_margins=False), self._warnings)


def print_unsaved(scene: Scene, name: str) -> None:
    """Keeps live values that are in no file, and prints the command that writes them. `name`: of the scene."""
    try:
        kept = keep_unsaved(scene, name)
    except (OSError, UsageError) as error:
        output.print_message(f"the unsaved values could not be kept: {error}", "unsaved", "warning")
        return
    if kept:
        does = "this shows how the file was changed meanwhile" if kept.is_changed else "this writes it"
        sentence = f"not saved: {', '.join(kept.names)}. The whole scene is kept; {does}:\n  {kept.command}"
        output.print_message(sentence, "unsaved", "warning", file=str(kept.path), command=kept.command)
