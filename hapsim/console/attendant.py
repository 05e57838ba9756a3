"""What `hapsim run` tells beside its live line: what the real-time set-up got, and what an edit of the file came to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from hapsim.realtime import Grant
    from hapsim.running import Session
    from hapsim.scene import Scene


def show_grants(error: Console, grants: Sequence[Grant]) -> None:
    """A line for each measure, got or denied and why."""
    for grant in grants:
        sign = "[green]got[/green]   " if grant.got else "[yellow]denied[/yellow]"
        error.print(f"{sign} {grant.measure}: {escape(grant.detail)}", soft_wrap=True, highlight=False)


class Attendant:
    """Told by a run that it has started, and now and then while it runs. `watched`: the file to follow, if any;
    `about(scene)` says what there is to be said of a changed scene."""

    def __init__(self, error: Console, watched: str | None, about: Callable[[Scene], None]) -> None:
        from hapsim.running.following import FollowedFile

        self._error = error
        self._file = FollowedFile(watched) if watched is not None else None
        self._about = about
        self.grants: list[Grant] = []

    def started(self, session: Session) -> None:
        """The device is armed."""
        self.grants = session.grants
        show_grants(self._error, session.grants)

    def look(self, session: Session) -> None:
        """Some twenty times a second."""
        from hapsim.realtime.giving_way import giving_way

        news = self._file.look(session) if self._file is not None else None
        if news is None:
            return
        if news.refused:
            self._say(f"{news.refused}\nNothing was changed.")
        for change in news.changed:
            self._say(f"changed: {change}")
        if news.changed:
            giving_way(lambda: self._about(session.scene))

    def _say(self, text: str) -> None:
        self._error.print(text, soft_wrap=True, highlight=False, markup=False)
