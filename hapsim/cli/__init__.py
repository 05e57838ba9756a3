"""What `hapsim` calls: from here on signals are heard, before the command line and all that it takes are loaded."""

from __future__ import annotations

from hapsim.stopping import heard_from_the_start


def main() -> None:
    """The command line: every failure is a sentence and an exit status, and with --json a document of both."""
    with heard_from_the_start() as from_now_on_by_exception:
        from hapsim.cli.command_line import run_command

        run_command(from_now_on_by_exception)
