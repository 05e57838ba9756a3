"""A command's docstring as `--help` shows it, broken where the terminal ends and not where the source does."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def help_text(command: Callable[..., Any]) -> str:
    """Its paragraphs, each in one line: typer breaks most of them where the docstring does."""
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.splitlines()) for paragraph in paragraphs)
