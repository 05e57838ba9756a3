"""Results as JSON documents. Keys are a contract with scripts; a value that does not exist is null, never NaN."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapsim.errors import HapsimError


def document(value: dict[str, Any]) -> str:
    """Returns the text of one JSON document."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def failure_document(failure: HapsimError | None) -> dict[str, Any]:
    """Returns the keys that say how a command failed; none if it did not."""
    return {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}


def plain(value: Any) -> Any:
    """Returns only what JSON has: complex numbers as [re, im], infinities and NaN as null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        entries = value.tolist() if hasattr(value, "tolist") else value
        return [plain(entry) for entry in entries] if isinstance(entries, (list, tuple)) else plain(entries)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
