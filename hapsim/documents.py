"""JSON documents: a result is its document.

A dataclass or a NamedTuple becomes an object with a key for each of its fields. Where keys and fields differ, the class
lists its keys in `DOCUMENT`, in words that `pick` takes.
"""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any


def plain(value: Any) -> Any:
    """Returns only what JSON has: results as objects, complex numbers as [re, im], infinities and NaN as null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    elif hasattr(value, "DOCUMENT"):
        value = pick(value, value.DOCUMENT)
    elif _names(value):
        value = pick(value, "*")
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, complex):
        value = value.real, value.imag
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def pick(source: Any, words: str) -> dict[str, Any]:
    """Returns attributes of an object by their keys.

    A word is `key`, the name of an attribute, or `key=attribute`. Both may have dots: `limits.k=felt.k` is k of the
    object limits. An attribute of None is None, and of a tuple its number is one: `written.0`. With `?` behind it, what
    is empty or zero is None. `*` stands for the fields, `*robustness` for the keys of that attribute.
    """
    picked: dict[str, Any] = {}
    for word in words.split():
        key, _, path = word.rstrip("?").partition("=")
        if key == "*":
            picked |= {name: getattr(source, name) for name in _names(source)}
            continue
        value = source
        for name in (path or key.lstrip("*")).split("."):
            value = None if value is None else value[int(name)] if name.isdigit() else getattr(value, name)
        if key.startswith("*"):
            picked |= pick(value, getattr(value, "DOCUMENT", "*"))
            continue
        *above, last = key.split(".")
        place = picked
        for name in above:
            place = place.setdefault(name, {})
        place[last] = value or None if word.endswith("?") else value
    return picked


def _names(source: Any) -> tuple[str, ...]:
    """Returns the fields of a dataclass or NamedTuple; () for all else."""
    if is_dataclass(source) and not isinstance(source, type):
        return tuple(one.name for one in fields(source))
    return tuple(getattr(source, "_fields", ()))
