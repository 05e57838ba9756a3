"""Writes vectors.json, sessions.json and parts of the documents: `python -m firmware_protocol.make_vectors`.

Run it after a change of the protocol; a test fails until it was. The C header's constants are changed by hand.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from firmware_protocol.document import porting_blocks, with_blocks
from firmware_protocol.sessions import sessions
from firmware_protocol.vectors import vectors

_HERE = Path(__file__).parent
VECTORS = _HERE / "vectors.json"
SESSIONS = _HERE / "sessions.json"
DOCUMENT = _HERE / "PROTOCOL.md"
PORTING = _HERE / "PORTING.md"


def vectors_text() -> str:
    """vectors.json as it has to be: one vector a line, so that a difference can be read."""
    return _by_lines(vectors())


def sessions_text() -> str:
    """sessions.json as it has to be: one session a line."""
    return _by_lines(sessions())


def document_text() -> str:
    """PROTOCOL.md as it has to be."""
    return with_blocks(DOCUMENT.read_text("utf-8"))


def porting_text() -> str:
    """PORTING.md as it has to be."""
    return with_blocks(PORTING.read_text("utf-8"), porting_blocks())


def _by_lines(document: dict[str, Any]) -> str:
    members = [f"{json.dumps(name)}: {_member(value)}" for name, value in document.items()]
    return "{\n" + ",\n".join(members) + "\n}\n"


def _member(value: Any) -> str:
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(json.dumps(entry) for entry in value) + "\n]"


def main() -> None:
    VECTORS.write_text(vectors_text(), "utf-8")
    SESSIONS.write_text(sessions_text(), "utf-8")
    DOCUMENT.write_text(document_text(), "utf-8")
    PORTING.write_text(porting_text(), "utf-8")
    print(f"wrote {VECTORS}, {SESSIONS}, {DOCUMENT} and {PORTING}")


if __name__ == "__main__":
    main()
