"""Sentences for people: on a terminal they break at words, elsewhere they stay as they are.

Left to itself, a terminal that is too narrow breaks them within a word. They do not go through rich, which would break
a long path: a path is to be copied.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
from typing import TextIO

_PLACE = re.compile(r"\S.*?:\d+:\d+:")  # file:line:column; the file's name may have spaces
_INDENT = "    "  # of what goes on in the next line
_NO_SPACE = "\0"  # stands for a space at which no line breaks


def say(sentences: object, stream: TextIO | None = None, indent: str = _INDENT) -> None:
    """Writes them to `stream`, standard output where none is given; `indent`: of what goes on in the next line."""
    stream = stream or sys.stdout
    print(fitted(str(sentences), _columns(stream), indent), file=stream)


def fitted(text: str, columns: int | None, indent: str = _INDENT) -> str:
    """`text` with every line that is longer than `columns` broken at spaces; None: as it is.

    A word that is longer by itself stays whole, and so does the place, file:line:column, that a line begins with.
    """
    if columns is None:
        return text
    return "\n".join(_fitted(line, columns, indent) if len(line) > columns else line for line in text.split("\n"))


def _fitted(line: str, columns: int, indent: str) -> str:
    if place := _PLACE.match(line):
        line = place.group().replace(" ", _NO_SPACE) + line[place.end() :]
    broken = textwrap.fill(
        line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, tabsize=4
    )
    return broken.replace(_NO_SPACE, " ")


def _columns(stream: TextIO) -> int | None:
    """How wide the terminal is; None where there is none."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError):  # no terminal, or nothing that the system knows
        return None
