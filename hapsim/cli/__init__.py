"""Entry point of `hapsim`. It handles signals first, and loads the command line afterwards."""

from __future__ import annotations

import atexit
import gc
import os
import sys

from hapsim.stopping import end_interrupted, ignore_stops, stops_as_interrupts


def main() -> None:
    """Runs the command line and exits. Every failure is a sentence and an exit status, with --json a document too."""
    gc.disable()  # until the command is loaded: collecting what stays takes a tenth of a short command
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # a search takes 20 ms; hapsim has none
    with stops_as_interrupts():
        try:
            from hapsim.cli.command_line import run_command

            status = run_command()
        except KeyboardInterrupt:  # while the command line was loaded
            status = end_interrupted()
        finally:
            gc.enable()
            atexit.register(ignore_stops)  # all is printed: a signal would replace the exit status
    sys.exit(status)
