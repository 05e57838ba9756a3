"""The command line, called in this process as the console script calls it; figures told at the end of a run."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from hapsim import cli


@pytest.fixture(scope="session", autouse=True)
def _interrupts_are_heard() -> None:
    """A shell that starts pytest in the background has it ignore them; what is tested of them would wait for ever."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@dataclass(frozen=True)
class Answer:
    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """Standard output, which is one JSON document and holds no NaN or infinity."""

        def refuse(constant: str) -> None:
            pytest.fail(f"{constant} in JSON")

        document: dict[str, Any] = json.loads(self.out, parse_constant=refuse)
        return document

    @property
    def sentence(self) -> str:
        """Standard error after a failure: no traceback, no defect of ours; standard output has the same or nothing."""
        assert "Traceback" not in self.err
        assert "defect" not in self.err
        if self.out:
            assert self.document.keys() == {"error", "exit_status"}
            assert self.document["error"] in self.err
            assert self.document["exit_status"] == self.status
        return self.err


@pytest.fixture
def hapsim(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Calls `hapsim …` and tells what came of it."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("HAPSIM_TRACEBACK", raising=False)

    def call(*words: object) -> Answer:
        monkeypatch.setattr("sys.argv", ["hapsim", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        captured = capfd.readouterr()
        return Answer(int(caught.value.code or 0), captured.out, captured.err)

    return call


@dataclass(frozen=True)
class Figures:
    """What a test saw, for the pages that quote it. Told once, after the last test, whichever process saw it."""

    _record: Callable[[str, object], None]

    def most(self, what: str, value: float) -> None:
        """Of all that the run saw of it the largest; NaN where one was."""
        self._record("most", [what, float(value)])

    def count(self, what: str, number: int) -> None:
        """The sum of them."""
        self._record("count", [what, int(number)])

    def note(self, sentence: str) -> None:
        self._record("note", [sentence, 0])


@pytest.fixture
def figures(record_property: Callable[[str, object], None]) -> Figures:
    return Figures(record_property)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    told: dict[tuple[str, str], list[Any]] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport) and report.when == "call":
                for kind, (what, value) in (p for p in report.user_properties if p[0] in ("most", "count", "note")):
                    told.setdefault((kind, what), []).append(value)
    if told:
        terminalreporter.section("figures")
    for (kind, what), values in sorted(told.items()):
        if kind == "most":
            worst = math.nan if any(map(math.isnan, values)) else max(values)
            terminalreporter.line(f"{what}: {worst:.2g} at most, of {len(values)}")
        else:
            terminalreporter.line(what if kind == "note" else f"{what}: {sum(values)}")
