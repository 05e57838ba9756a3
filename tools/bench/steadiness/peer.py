"""One job in a Python process of its own: `python -m steadiness.peer JOB`, a JSON document; another one is printed."""

from __future__ import annotations

import json
import sys
from typing import Any


def _do(job: dict[str, Any]) -> Any:
    what = job.pop("do")
    if what == "compute":
        from steadiness.in_memory import measure_in_memory

        return measure_in_memory(**job)
    if what == "run":
        from steadiness.on_port import run_on_port

        return run_on_port(**job)
    if what == "wakeups":
        from steadiness.wakeups import sleep_here

        return sleep_here(**job)
    if what == "load":
        from steadiness.loads import serve_load

        return serve_load(**job)
    raise ValueError(f"no such job: {what}")


if __name__ == "__main__":
    print(json.dumps(_do(json.loads(sys.argv[1]))), flush=True)
