"""Pages name files, functions, classes and tables that exist."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TRACKED = subprocess.run(["git", "ls-files"], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.split()
PAGES = [one for one in TRACKED if one.endswith(".md") and one != "CHANGELOG.md"]
PLACEHOLDER = "NAME"

_FILE = r"((?:[\w-]+/)*[\w-]+\.(?:py|js|c|h))"


def of_name(name: str) -> list[str]:
    """The files that a page may mean by this end of a path."""
    return [one for one in TRACKED if f"/{one}".endswith(f"/{name}")]


@pytest.mark.parametrize("page", PAGES)
def test_every_file_that_a_page_names_exists(page: str) -> None:
    named = set(re.findall(f"`{_FILE}`", (REPOSITORY / page).read_text("utf-8")))
    assert [one for one in sorted(named) if PLACEHOLDER not in one and not of_name(one)] == []


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_places_in_a_file_stands_there(page: str) -> None:
    placed = re.findall(
        rf"`([A-Za-z_]\w*)`(?:\s+and\s+`([A-Za-z_]\w*)`)?\s+(?:in|of)\s+`{_FILE}`",
        (REPOSITORY / page).read_text("utf-8"),
    )
    wrong = [
        f"{name} in {file}"
        for *names, file in placed
        for name in filter(None, names)
        if PLACEHOLDER not in file
        and not any(re.search(rf"\b{name}\b", (REPOSITORY / one).read_text("utf-8")) for one in of_name(file))
    ]
    assert wrong == []


def test_a_file_name_occurs_once() -> None:
    """So that a page, an editor or an engineer means one file by it."""
    files = Counter(
        Path(one).name for one in TRACKED if one.startswith(("hapsim/", "firmware_protocol/")) and one.endswith(".py")
    )
    assert [name for name, times in files.items() if times > 1 and name != "__init__.py"] == []
