"""The command line, called in this process as the console script calls it."""

from __future__ import annotations

import json
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
