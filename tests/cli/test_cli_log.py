"""Standard error as lines of JSON: the sentences that people read, each event at most once a second."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hapsim.cli.output import JsonLog

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

KEYS = {"time", "level", "event", "message", "fields"}


def lines_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_every_line_is_json_with_the_text_that_people_read(hapsim: Hapsim, scene_file: SceneFile) -> None:
    words = ("run", scene_file("unstable"), "--unstable", "--duration", 0.05, "--json")
    for_people = hapsim(*words).err
    answer = hapsim(*words, "--log", "json", "--realtime")
    told = lines_of(answer.err)
    assert answer.document["ticks"] == 50
    assert all(line.keys() == KEYS for line in told)
    events = [line["event"] for line in told if line["event"] not in ("granted", "denied", "compiling")]
    assert events == ["prediction", "armed", "running", "ended"]
    assert f"Warning: {told[0]['message']}\n" in for_people
    assert told[0]["level"] == "warning"
    assert sum(line["event"] in ("granted", "denied") for line in told) == 5
    assert told[-1]["fields"] == {"ticks": 50, "ending": "done", "reconnections": 0}


def test_what_fails_is_a_line_of_json_too_and_the_next_command_prints_for_people_again(
    hapsim: Hapsim, scene_file: SceneFile
) -> None:
    path = scene_file("spring", port="/dev/ttyNOPE7")
    answer = hapsim("run", path, "--log", "json")
    assert answer.status == 3
    (failed,) = [line for line in lines_of(answer.err) if line["event"] != "compiling"]
    assert (failed["level"], failed["event"]) == ("error", "failed")
    assert failed["message"].startswith("/dev/ttyNOPE7: no such port")
    assert hapsim("run", path).err.splitlines()[-1] == failed["message"]
    assert hapsim("run", path, "--log", "xml").sentence.startswith("--log: found 'xml', expected text or json")


def test_an_event_comes_once_a_second_with_how_many_did_not() -> None:
    now, lines = [0.0], []
    log = JsonLog(lines.append, clock=lambda: now[0])
    for now[0] in (0.0, 0.5, 0.9, 1.0, 1.2):
        log.write("info", "lost", "gone", position=float("nan"))
        log.write("info", "changed", "other", about=str(now[0]))
    log.write("info", "back", "here")
    log.close()
    log.close()
    told = [(line["event"], line.get("left_out")) for line in lines_of("".join(lines)) if line["event"] != "changed"]
    assert told == [("lost", None), ("lost", 2), ("back", None), ("lost", 1)]
    assert sum("other" in line for line in lines) == 5
    assert json.loads(lines[0])["fields"] == {"position": None}
