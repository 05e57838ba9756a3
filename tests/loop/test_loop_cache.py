"""Location of the code cache: separate for every state of the sources, and only where no other user can write."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numba
import pytest

from firmware_protocol import code_cache, compiled

SOURCES = {
    "package/tick.py": "from package.room import one\n",
    "package/room/__init__.py": "",
    "package/room/one.py": "x = 1\n",
    "package/outside.py": "z = 3\n",
}
"""A package of which `tick.py` is compiled. It stands outside of the room itself."""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sources that stand beside firmware_protocol, as far as the cache can see."""
    for name, text in SOURCES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(code_cache, "__file__", str(tmp_path / "firmware_protocol" / "code_cache.py"))
    return tmp_path / "package"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(code_cache.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return tmp_path / "cache" / "hapsim"


def forget() -> None:
    """Clears this process's memory of the sources, as in a new process."""
    names = ("directory_for", "read_only_directories_for", "_key_of", "_imports_of", "_files_of", "_digest_of")
    for name in names:
        getattr(code_cache, name).cache_clear()


def directory_for(package: Path, *sources: str) -> Path | None:
    """Returns the cache directory that a new process would choose for code from these sources."""
    forget()
    try:
        return code_cache.directory_for(
            frozenset(package / source for source in sources or ("tick.py",)), (package / "room",)
        )
    finally:
        forget()


@pytest.mark.usefixtures("cache")
def test_another_source_next_to_it_gives_another_directory(package: Path) -> None:
    """A second source, such as a class whose field order is compiled in, changes the directory."""
    assert directory_for(package, "tick.py", "outside.py") not in (
        directory_for(package),
        directory_for(package, "outside.py"),
    )


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize(
    ("owner", "name"),
    [(numba, "__version__"), (code_cache.platform, "machine"), (code_cache.platform, "python_version")],
)
def test_each_compiler_and_machine_has_a_directory(
    package: Path, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str
) -> None:
    before = directory_for(package)
    monkeypatch.setattr(owner, name, "0.0" if owner is numba else lambda: "another")
    assert directory_for(package) != before


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o707])
@pytest.mark.parametrize("below", [False, True])
def test_a_cache_open_to_others_is_ignored(package: Path, cache: Path, tmp_path: Path, mode: int, below: bool) -> None:
    """Or a directory below it."""
    cache.mkdir(parents=True, mode=0o700)
    open_to_all = directory_for(package) if below else cache
    open_to_all.chmod(mode)
    files = list(cache.rglob("*"))
    directory = directory_for(package)
    assert directory.is_relative_to(tmp_path / "temporary")
    assert list(cache.rglob("*")) == files


def test_a_cache_of_another_user_is_ignored(package: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = directory_for(package)
    assert (directory.parent, directory.stat().st_mode & 0o777) == (cache, 0o700)
    monkeypatch.setattr(os, "getuid", lambda: os.stat(cache).st_uid + 1)
    assert directory_for(package) is None  # nor is the temporary one ours


def test_a_system_without_users_ignores_the_mode(package: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    owner = os.getuid()
    monkeypatch.delattr(os, "getuid")
    monkeypatch.setattr(code_cache, "_user", lambda: owner)  # there every file is of owner 0
    directory = directory_for(package)
    assert directory.parent == cache


def test_without_a_cache_the_temporary_directory_serves_or_none(package: Path, cache: Path, tmp_path: Path) -> None:
    """Functions are compiled all the same."""
    cache.parent.write_text("a file is in the way", encoding="utf-8")
    directory = directory_for(package)
    assert directory.is_relative_to(tmp_path / "temporary")
    shutil.rmtree(tmp_path / "temporary")
    (tmp_path / "temporary").write_text("here too", encoding="utf-8")
    assert directory_for(package) is None

    @compiled.Compiler(package).entry
    def double(x: int) -> int:
        return 2 * x

    forget()
    assert double(21) == 42


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("setting", ["", "/somewhere/of/theirs"])
def test_a_program_keeps_its_own_setting_of_numba(package: Path, monkeypatch: pytest.MonkeyPatch, setting: str) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", setting)

    @compiled.Compiler(package).entry
    def half(x: float) -> float:
        return x / 2

    forget()
    assert setting == numba.config.CACHE_DIR


def test_what_was_not_loaded_for_a_month_is_removed_and_the_rest_kept(package: Path, cache: Path) -> None:
    def aged(name: str, days: float) -> Path:
        directory = cache / name
        (directory / "inside").mkdir(parents=True)
        then = directory.stat().st_mtime - 86400.0 * days
        os.utime(directory, (then, then))
        return directory

    used = directory_for(package)
    os.utime(used, (0.0, 0.0))
    assert directory_for(package) == used  # loading from it keeps it
    old, recent = aged(16 * "0", 31.0), aged(16 * "1", 29.0)
    assert directory_for(package) == used
    assert old.exists()  # it is looked for once the sources change, and not at every start
    (package / "tick.py").write_text("changed = True\n", encoding="utf-8")
    newest = directory_for(package)
    assert newest not in (None, used)
    assert sorted(cache.iterdir()) == sorted([recent, used, newest])  # type: ignore[list-item]


ORDER = """
import ctypes
os.environ["XDG_CACHE_HOME"] = sys.argv[1]
sys.path.insert(0, sys.argv[1])
from numba.core import types
from hapsim.compiling.native import Behind, NativeFunction
from difference import difference
from numbers_of_it import Numbers

compiled = NativeFunction(difference, types.float64)
function, numbers = compiled.call_on(Behind(Numbers(minuend=5.0, subtrahend=2.0)))
print(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(function)(numbers))
"""


def test_numbers_whose_order_has_changed_are_not_read_by_what_was_compiled_for_the_old_one(
    start_hapsim: Any, tmp_path: Path
) -> None:
    """numba tells two tuples with the same names and other places apart by neither their type nor the function."""
    (tmp_path / "difference.py").write_text(
        "from hapsim.compiling.native import value_of\n\n"
        "def difference(numbers):\n    numbers = value_of(numbers)\n    return numbers.minuend - numbers.subtrahend\n",
        encoding="utf-8",
    )
    fields = ["minuend: float", "subtrahend: float"]
    for order in (fields, fields[::-1], fields):
        (tmp_path / "numbers_of_it.py").write_text(
            "from typing import NamedTuple\n\nclass Numbers(NamedTuple):\n    " + "\n    ".join(order) + "\n",
            encoding="utf-8",
        )
        shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
        done = start_hapsim(tmp_path, program=ORDER)
        assert done.wait() == 0, done.err
        assert done.out == "3.0\n"
    assert len([*(tmp_path / "hapsim").rglob("*.nbc")]) == 2
