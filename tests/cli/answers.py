"""`hapsim …`, many times in one process. Each line of standard input has the words of a command, as a list in JSON; a
line of standard output answers with its [status, output, errors]. `["-c", CODE]` runs Python."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import traceback
from collections.abc import Callable


def answer_to(words: list[str]) -> tuple[int, str, str]:
    """Returns the exit status, output and errors of `hapsim` with these words."""
    from hapsim.cli import main

    sys.argv = ["hapsim", *words]
    kept, status = [os.dup(number) for number in (1, 2)], 0
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as output,
        tempfile.TemporaryFile("w+", encoding="utf-8") as errors,
    ):
        for number, file in enumerate((output, errors), 1):
            os.dup2(file.fileno(), number)
        try:
            if words[0] == "-c":
                exec(words[1], {"__name__": "answered"})
            else:
                main()
        except SystemExit as end:
            status = int(end.code or 0)
        except Exception:
            traceback.print_exc()
            status = 1
        for number, stream in enumerate((sys.stdout, sys.stderr), 1):
            stream.flush()
            os.dup2(kept[number - 1], number)
            os.close(kept[number - 1])
        return status, *(file.seek(0) or file.read() for file in (output, errors))


def answer_all(before: Callable[[list[str]], None] = lambda _: None) -> None:
    """Answers to the lines of standard input. `before` is called with the words of each command."""
    for line in sys.stdin:
        words = json.loads(line)
        before(words)
        answer = answer_to(words)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    answer_all()
