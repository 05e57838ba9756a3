"""What `hapsim run` shows beside its live line: what real time was granted, and what became of an edit of the file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from hapsim.cli.log import Level, json_log
from hapsim.cli.sentences import fitted

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.progress import Progress
    from hapsim.running import Session
    from hapsim.running.reconnecting import Observer
    from hapsim.running.watch import WatchedFile
    from hapsim.scene import Scene

_LOOK_S = 0.05  # how often the file is looked at


def show_grants(error: Console, grants: Sequence[PrivilegeResult]) -> None:
    """A line for each privilege, granted or denied and why."""
    log = json_log()
    for grant in grants:
        if log is not None:
            word = "granted" if grant.granted else "denied"
            sentence = f"{word} {grant.privilege}: {grant.detail}"
            log.say("info" if grant.granted else "warning", word, sentence, about=sentence, **vars(grant))
            continue
        sign = "[green]granted[/green]" if grant.granted else "[yellow]denied[/yellow] "
        error.print(
            f"{sign} {grant.privilege}: {escape(grant.detail)}", soft_wrap=not error.is_terminal, highlight=False
        )


class RunReporter:
    """Reports that a run has started, and what it makes of edits while it runs. `watched`: the file to follow, if any;
    `about(scene)` says what there is to be said of a changed scene."""

    def __init__(self, error: Console, watched: str | None, about: Callable[[Scene], None]) -> None:
        from hapsim.running.watch import WatchedFile

        self._error = error
        self._file = WatchedFile(watched) if watched is not None else None
        self._about = about
        self.grants: list[PrivilegeResult] = []
        self._placed = False  # whether it was looked at where the device was armed

    def started(self, session: Session) -> None:
        """The device is armed. From now on the file is followed, in a thread of its own: nobody waits for it."""
        from hapsim.loop.realtime.giving_way import Beside

        self.grants, self._placed = session.grants, False
        log = json_log()
        if log is not None:
            log.say("info", "armed", f"the device is armed; {session.scene.path or 'the scene'} runs")
        show_grants(self._error, session.grants)
        if self._file is not None:
            file = self._file
            Beside(lambda: self._follow(file, session), session.gives_way)

    def observer(self, tell: Callable[[Progress], None], port: str) -> Observer:
        """What has a run be reported: by sentences, and by `tell` on a live line."""
        from hapsim.progress import Progress
        from hapsim.running.reconnecting import Observer

        return Observer(
            arming=lambda: self._meet(port),
            started=self.started,
            running=lambda progress: self._running(progress, tell),
            waiting=lambda: tell(Progress("waiting", port)),
            tell=lambda event, sentence: self._say(event, sentence, "info" if event == "reconnected" else "warning"),
        )

    def _meet(self, port: str) -> None:
        """Says of a device that answers for the first time what it has not shown yet. `port`: empty for the mock."""
        from hapsim.device.known_devices import is_new

        if port and is_new(port):
            self._say(
                "new device",
                f"First run at {port}: `hapsim probe {port} --push 0.5`, or `hapsim identify`, judges whether its "
                "motor pushes the right way. Hold it loosely until then.",
            )

    def _running(self, progress: Progress, tell: Callable[[Progress], None]) -> None:
        """Shows it; and says, once for each arming, where the device was armed outside its travel."""
        if progress.phase == "running" and progress.ticks > 0 and not self._placed:
            self._placed = True
            if progress.faded_ticks == progress.ticks:
                places = ", ".join(f"{one:.6g}" for one in progress.position)
                self._say(
                    "outside",
                    f"the device was armed outside device.travel (it is at {places} m): there the force fades, and is "
                    "zero beyond the band. Move it within, or say with device.origin where its zero is",
                    "warning",
                )
        tell(progress)

    def _follow(self, file: WatchedFile, session: Session) -> None:
        while not session.wait(_LOOK_S):
            news = file.look(session)
            if news is None:
                continue
            if news.refused:
                self._say("refused", f"{news.refused}\nNothing was changed.", "warning")
            for change in news.changed:
                self._say("changed", f"changed: {change}")
            if news.changed:
                self._about(session.scene)

    def _say(self, event: str, text: str, level: Level = "info") -> None:
        log = json_log()
        if log is not None:
            log.say(level, event, text, about=text)
            return
        columns = self._error.width if self._error.is_terminal else None
        self._error.print(fitted(text, columns), soft_wrap=True, highlight=False, markup=False)
