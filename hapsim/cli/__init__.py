"""What `hapsim` calls. It handles signals first; the command line and all that it takes are loaded afterwards."""

from __future__ import annotations

import sys

from hapsim.stopping import end_interrupted, stops_as_interrupts


def main() -> None:
    """Runs the command line and exits. Every failure is a sentence and an exit status, with --json a document too."""
    with stops_as_interrupts():
        try:
            from hapsim.cli.command_line import run_command

            status = run_command()
        except KeyboardInterrupt:  # while the command line was loaded
            status = end_interrupted()
    sys.exit(status)
