"""Starts programs in processes of their own that have everything imported: a start takes milliseconds, not seconds.

`conftest.Forked` speaks to it. A line of standard input is JSON: an object with a program, the words of its command
line, and files for its two outputs, is answered by the number of its process; such a number by the exit status, null
while it runs.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from typing import Any

import hapsim
from hapsim import cli
from hapsim.scene import parse_scene
from hapsim.scene.shipped import shipped_scene

LOCKSTEP = shipped_scene("first_touch.yaml").replace("clock: device", "clock: lockstep")


def load_all() -> None:
    """Loads the imports of runs and measurements, and the machine code of the loop and of the mock."""
    hapsim.run(parse_scene(LOCKSTEP), duration=0.01, transport="terminal")
    sys.argv = ["hapsim", "measure", "first_touch", "--duration", "0.3", "--json"]
    nowhere = io.StringIO()
    with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere), contextlib.suppress(SystemExit):
        cli.main()


def status_of(process: int) -> int | None:
    ended, status = os.waitpid(process, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if ended else None


def serve() -> dict[str, Any]:
    """Serves requests. In each process that it forks it returns what that is to do, in the first one nothing."""
    for line in sys.stdin:
        request = json.loads(line)
        if isinstance(request, int):
            print(json.dumps(status_of(request)), flush=True)
        elif process := os.fork():
            print(process, flush=True)
        else:
            return dict(request)
    return {"program": ""}


load_all()
work = serve()
if work["program"]:
    os.setsid()
    with contextlib.suppress(PermissionError):
        os.nice(-15)  # as the boards do, before the other programs of this machine
    for number, name in enumerate((os.devnull, *work["outputs"])):
        os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
    sys.argv = work["argv"]
exec(work["program"])
