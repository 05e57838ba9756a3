"""What several commands' options have in common."""

from __future__ import annotations

from hapsim.errors import UsageError


def names(words: list[str] | None) -> list[str]:
    """Of an option that may be repeated, and may hold several words with commas between them."""
    return ",".join(words).split(",") if words else []


def numbers(option: str, words: list[str] | None) -> list[float]:
    """Of an option that may be repeated, and may hold several numbers with commas between them; ordered, each once."""
    found = set()
    for word in ",".join(words or []).split(",") if words else []:
        try:
            found.add(float(word))
        except ValueError:
            raise UsageError(
                f"{option}: found '{word}', expected a number, or several with commas between them"
            ) from None
    return sorted(found)
