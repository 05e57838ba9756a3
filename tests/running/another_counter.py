"""A program that adds an entry to the table of counters before anything else of hapsim is imported, counts as the loop
does, and prints what is shown of it. Nothing is compiled."""

from __future__ import annotations

import io
import json
import sys
import types
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ENTRY = '    odd_ticks: int = _counter("ticks that were odd", "odd", status=True, at="state")\n'
COUNTED = 4321


def add_entry() -> None:
    spec = find_spec("hapsim.loop.counts")
    origin = str(spec and spec.origin)
    source = Path(origin).read_text("utf-8").replace("    lost_frames: int", f"{ENTRY}    lost_frames: int")
    table = sys.modules["hapsim.loop.counts"] = types.ModuleType("hapsim.loop.counts")
    exec(compile(source, origin, "exec"), vars(table))


def shown(file: str) -> dict[str, Any]:
    """Returns every output that shows the counter, from a run of this scene file."""
    from websockets.datastructures import Headers

    from firmware_protocol.description import Description
    from hapsim.cli.live import _of_a_run
    from hapsim.cli.run_command import lifetime_document, show_report
    from hapsim.cli.status_command import show_status
    from hapsim.device.connection import Connection
    from hapsim.live.access import Address
    from hapsim.live.hub import Hub
    from hapsim.live.web import WebView
    from hapsim.recording.report import read_summary, summary_document
    from hapsim.running.assemble_loop import LoopMemory
    from hapsim.running.outcome import progress_of, report_of
    from hapsim.running.reconnecting import Lifetime
    from hapsim.running.status import RunState
    from hapsim.scene import load_scene

    report: Any
    scene = load_scene(file)
    description = Description("test", scene.rate, 0b111, 200, (1e-6,), (1e-3,), (10.0,))
    loop = LoopMemory(Connection(None, "mock", lambda: None), description, False, scene.device.clock)  # type: ignore[arg-type]
    loop.rendered_scene, loop.record.slot.substeps = scene, 1
    loop.state.odd_ticks += COUNTED
    progress = progress_of(loop)
    report, statistics = report_of(scene, loop, "done")
    read: Any = read_summary(json.loads(json.dumps(summary_document(report, statistics, True))))[0]
    session: Any = SimpleNamespace(progress=lambda: progress, statistics=lambda: statistics)
    state = RunState(file, None, scene.rate)
    state.observer.started(session)
    view = WebView(Hub(scene), Address("127.0.0.1", "127.0.0.1", 7470), print)
    request: Any = SimpleNamespace(path="/counters.json", headers=Headers(Host="127.0.0.1:7470"))
    words: Any = view._process(None, request)  # type: ignore[arg-type]
    return {
        "report": report.odd_ticks,
        "record": read.odd_ticks,
        "JSON": lifetime_document(Lifetime(report, None, ()))["odd_ticks"],
        "table": printed(show_report, report),
        "status": state.document()["odd_ticks"],
        "status as text": printed(show_status, state.document()),
        "live line": list(_of_a_run(progress)),
        "page": json.loads(view.counters(session))["progress"]["odd_ticks"],
        "words on the page": json.loads(words.body)["odd_ticks"],
    }


def printed(show: Any, what: Any) -> str:
    from rich.console import Console

    console = Console(record=True, width=200, file=io.StringIO())
    show(console, what)
    return console.export_text()


if __name__ == "__main__":
    add_entry()
    print(json.dumps(shown(sys.argv[1])))
