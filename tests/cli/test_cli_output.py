"""Output that cannot be written: a reader that has seen enough, a full disk."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SHIPPED = Path(__file__).parents[2] / "configs" / "first_touch.yaml"
HAPSIM = [sys.executable, "-m", "hapsim"]


@pytest.fixture
def unread() -> Iterator[int]:
    """A pipe without a reader."""
    read, write = os.pipe()
    os.close(read)
    yield write
    os.close(write)


def environment(buffered: bool) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return kept | ({} if buffered else {"PYTHONUNBUFFERED": "1"})


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("words", "buffered"),
    [
        (["schema"], True),
        (["schema"], False),
        (["--version"], True),
        (["--help"], False),
        (["check", str(SHIPPED)], True),
    ],
)
def test_a_reader_that_has_seen_enough_is_no_failure(unread: int, words: list[str], buffered: bool) -> None:
    done = subprocess.run(
        [*HAPSIM, *words], stdout=unread, stderr=subprocess.PIPE, text=True, check=False, env=environment(buffered)
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_failure_stays_one_without_a_reader(unread: int) -> None:
    done = subprocess.run(
        [*HAPSIM, "check", "nowhere.yaml"], stdout=unread, stderr=unread, check=False, env=environment(True)
    )
    assert done.returncode == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a file that is always full is Linux's")
@pytest.mark.parametrize("words", [["schema"], ["--version"]])
def test_a_full_disk_is_a_sentence(words: list[str]) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*HAPSIM, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment(True)
        )
    assert done.returncode == 2
    assert done.stderr == "hapsim: the output cannot be written: No space left on device\n"


def test_what_a_reader_took_before_it_went_is_there() -> None:
    command = f"{sys.executable} -m hapsim schema | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "{\n", "")
