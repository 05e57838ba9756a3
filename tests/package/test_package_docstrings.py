"""Docstrings and names are plain English: a docstring begins with the thing or the act, a name has the field's word."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FIRST_WORDS = "What|Where|How|Whether|By|Of|Who|Whom|Whose|Why|Which|That|Those|Such|Its|Beside"
CLAUSE = re.compile(rf"({FIRST_WORDS})\b")

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


@cache
def tree_of(path: Path) -> ast.AST:
    return ast.parse(path.read_text(encoding="utf-8"))


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yields every text that stands as a statement, below a definition or an attribute, with its line."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else []:
            match statement:
                case ast.Expr(value=ast.Constant(value=str() as text)):
                    yield statement.lineno, text.strip()


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yields the names of functions and classes with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.lineno, node.name


def words_in(name: str) -> set[str]:
    """Returns the words of a name, in lower case: of `_Keeper` {"keeper"}."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)}


@pytest.mark.parametrize("area", AREAS)
def test_a_docstring_begins_with_the_thing_or_the_act(area: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in files_of(area)
        for line, text in docstrings(tree_of(path))
        if CLAUSE.match(text)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("area", AREAS)
def test_a_name_has_the_field_s_word(area: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in files_of(area)
        for line, name in [(1, path.stem), *names(tree_of(path))]
        if words_in(name) & NO_FIELD_WORD
    ]
    assert not found, "\n".join(found)
