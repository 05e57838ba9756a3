"""Docstrings and names are plain English: a docstring begins with the thing or the act, a name has the field's word."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FIRST_WORDS = "What|Where|How|Whether|By|Of|Who|Whom|Whose|Why|Which|That|Those|Such|Its|Beside"
CLAUSE = re.compile(rf'^ *r?"""\s*((?:{FIRST_WORDS})\b.*)', re.M)
NAME = re.compile(r"^ *(?:async )?(?:def|class) (\w+)", re.M)

NO_FIELD_WORD = {
    "hear",
    "hears",
    "heard",
    "tell",
    "tells",
    "told",
    "say",
    "says",
    "said",
    "speak",
    "speaks",
    "spoken",
    "complain",
    "complains",
    "complaints",
    "office",
    "beside",
    "followed",
    "keeper",
}

AREAS = ["firmware_protocol", "hapsim", "tests", "tools"]


def files_of(area: str) -> Iterator[Path]:
    """Yields the Python files of an area, scripts without .py too."""
    for path in sorted((ROOT / area).rglob("*")):
        if path.is_file() and (path.suffix == ".py" or (not path.suffix and _is_script(path))):
            yield path


def _is_script(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(40).startswith(b"#!/usr/bin/env python")


def found_in(area: str, pattern: re.Pattern[str]) -> Iterator[tuple[str, str]]:
    """Yields where a pattern stands in an area's files, and what its group is there."""
    for path in files_of(area):
        text = path.read_text(encoding="utf-8")
        for match in pattern.finditer(text):
            yield f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}", match[1]


def words_in(name: str) -> set[str]:
    """Returns the words of a name, in lower case: of `_Keeper` {"keeper"}."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)}


@pytest.mark.parametrize("area", AREAS)
def test_a_docstring_begins_with_the_thing_or_the_act(area: str) -> None:
    assert [f"{where}: {text}" for where, text in found_in(area, CLAUSE)] == []


@pytest.mark.parametrize("area", AREAS)
def test_a_name_has_the_field_s_word(area: str) -> None:
    named = [*found_in(area, NAME), *((str(path), path.stem) for path in files_of(area))]
    assert len(named) > 50
    assert [f"{where}: {name}" for where, name in named if words_in(name) & NO_FIELD_WORD] == []
