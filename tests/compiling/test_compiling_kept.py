"""Machine code that a later process finds: whole, damaged, or in a directory that cannot be written."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_functions import (
    EITHER,
    NAMES,
    add_two,
    anew,
    as_another_process,
    compile_entry,
    compile_native,
    reported_by,
)

from firmware_protocol import code_cache
from hapsim.compiling import entry, kept
from hapsim.compiling.kept import compile_for, is_kept
from hapsim.errors import UsageError

pytestmark = pytest.mark.usefixtures("cache")


# --- machine code that is damaged, cannot be written, or goes away ---


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def overwrite(file: Path) -> None:
    """Zeroes some bytes in the middle, which is machine code."""
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    file.write_bytes(content)


@EITHER
@pytest.mark.parametrize(
    ("files", "damage"),
    [(".nbc", truncate), (".nbc", overwrite), (".nbc", Path.unlink), (".nbi", empty), (".nbi", truncate)],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_damaged_machine_code_is_compiled_again_and_kept(
    cache: Path, compile_it: Callable[[], Any], files: str, damage: Callable[[Path], object]
) -> None:
    """Each compilation here calls the function, so damaged code that was executed would show, or end the process."""
    compile_it()
    (damaged,) = cache.rglob(f"*{files}")
    damage(damaged)
    assert NAMES[compile_it] in reported_by(compile_it)
    assert reported_by(compile_it) == []


@EITHER
@pytest.mark.parametrize("damage", [truncate, Path.unlink])
def test_a_damaged_mark_is_written_again(
    cache: Path, compile_it: Callable[[], Any], damage: Callable[[Path], object]
) -> None:
    compile_it()
    (mark,) = cache.rglob("*.kept")
    written = mark.read_bytes()
    damage(mark)
    compile_it()
    assert mark.read_bytes() == written
    assert reported_by(compile_it) == []


def test_kept_code_is_known_before_it_is_loaded() -> None:
    assert not is_kept(entry(anew(add_two)), 1)
    compile_entry()
    assert is_kept(entry(anew(add_two)), 1)
    assert not is_kept(entry(anew(add_two)), 1.0)


def test_a_second_signature_leaves_the_first_kept() -> None:
    compile_entry()
    compile_for(entry(anew(add_two)), 1.0)
    assert is_kept(entry(anew(add_two)), 1)
    assert is_kept(entry(anew(add_two)), 1.0)


@EITHER
def test_code_that_cannot_be_written_is_compiled_all_the_same_and_kept_later(compile_it: Callable[[], Any]) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))  # as on a full disk
    try:
        assert NAMES[compile_it] in reported_by(compile_it)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert NAMES[compile_it] in reported_by(compile_it)
    assert reported_by(compile_it) == []


def test_why_code_is_not_kept_is_known(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    compile_entry()
    assert kept.why_not_kept() == ""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    try:
        compile_native()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert kept.why_not_kept() == f"{cache / 'hapsim'} cannot be written: File too large"
    monkeypatch.setattr(code_cache, "_roots", tuple)
    as_another_process()
    assert kept.directory_of_kept_code() is None
    assert kept.why_not_kept() == "no directory for it can be written"
    for compile_it, name in NAMES.items():
        assert name in reported_by(compile_it)


# --- a cache that can be read and not written ---


@pytest.fixture
def image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache that the environment names, with the entry compiled; this process can no longer write to it, as in a
    container, whose own cache is empty."""
    image = tmp_path / "image"
    monkeypatch.setenv("HAPSIM_CACHE", str(image))
    compile_entry()
    assert kept.directory_of_kept_code() == image  # `hapsim compile` reports it
    access = os.access

    def access_of_image(path: Any, mode: int) -> bool:
        return access(path, mode) and not (mode & os.W_OK and Path(path).is_relative_to(image))

    monkeypatch.setattr(os, "access", access_of_image)
    as_another_process()
    return image


def files_in(directory: Path) -> dict[Path, int]:
    return {file: file.stat().st_mtime_ns for file in directory.rglob("*") if file.is_file()}


def test_a_read_only_cache_is_used_and_what_it_lacks_is_kept_elsewhere(cache: Path, image: Path) -> None:
    before = files_in(image)
    assert reported_by(compile_entry) == []
    assert kept.directory_of_kept_code(found=True) == image
    assert NAMES[compile_native] in reported_by(compile_native)
    assert reported_by(compile_native) == []
    assert files_in(image) == before
    assert {file.suffix for file in files_in(cache / "hapsim")} == {".nbi", ".nbc", ".kept"}


def test_code_that_others_could_have_written_is_not_used(image: Path) -> None:
    image.chmod(0o777)
    assert reported_by(compile_entry) != []


def test_damage_in_a_read_only_cache_is_compiled_elsewhere(image: Path) -> None:
    overwrite(next(image.rglob("*.nbc")))
    before = files_in(image)
    assert reported_by(compile_entry) != []
    assert reported_by(compile_entry) == []
    assert files_in(image) == before


def test_an_image_for_another_processor_is_not_used(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert kept.directory_of_kept_code(found=True) == image
    monkeypatch.setattr(code_cache.numba.config, "CPU_NAME", "generic")
    as_another_process()
    assert kept.directory_of_kept_code(found=True) != image


def test_nothing_but_old_code_is_removed_from_a_directory_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPSIM_CACHE", str(tmp_path))
    for name in ("photographs", "0123456789abcdef"):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (0, 0))
    compile_entry()
    assert (tmp_path / "photographs").is_dir()
    assert not (tmp_path / "0123456789abcdef").exists()


MOUNTED = """
for folder in "$HAPSIM_CACHE" /tmp /var/tmp; do
    mount --bind "$folder" "$folder" && mount -o remount,bind,ro "$folder" || exit 99
done
cd / && exec "$0" -c "$1"
"""
READS = f"""
import sys
sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parents[2])]!r}
from small_functions import NAMES, reported_by
for compile_it in NAMES:
    print(compile_it.__name__, reported_by(compile_it))
"""


def test_a_cache_mounted_read_only_serves_where_nothing_else_can_be_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rm", "true"], check=False).returncode:
        pytest.skip("needs user and mount namespaces (unshare -rm), which this machine does not permit")
    with tempfile.TemporaryDirectory() as image:
        monkeypatch.setenv("HAPSIM_CACHE", image)
        monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
        as_another_process()
        for compile_it in NAMES:
            compile_it()
        command = ["unshare", "-rm", "sh", "-c", MOUNTED, sys.executable, READS]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    if done.returncode == 99:
        pytest.skip("this machine permits no read-only mount in a namespace")
    assert done.stdout == "compile_entry []\ncompile_native []\n", done.stderr[-2000:]


# --- where numba does not compile ---


def test_what_prevents_compilation_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "address_space_limit", lambda: 512_000_000)
    for compile_it in NAMES:
        with pytest.raises(UsageError, match="address space is limited to 512 MB"):
            compile_it()
    monkeypatch.setattr(kept.numba.config, "DISABLE_JIT", 1)
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT in the environment prevents: unset it"):
        compile_native()
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT"):
        is_kept(add_two, 1)
