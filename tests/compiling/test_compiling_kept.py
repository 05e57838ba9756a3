"""Functions are compiled once: progress, interrupts and the garbage collector meanwhile, and the machine code that a
later process finds, damaged or whole."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from firmware_protocol import code_cache
from hapsim.compiling import entry, helper, kept
from hapsim.compiling.kept import compile_for, is_kept
from hapsim.compiling.native import Behind, NativeFunction, value_of
from hapsim.compiling.progress import Counted, compiling, on_compilation
from hapsim.errors import UsageError


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache of this test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("HAPSIM_CACHE", raising=False)
    monkeypatch.setattr(kept, "_unkept", [])
    as_another_process()
    yield tmp_path
    as_another_process()


def as_another_process() -> None:
    """Directories are looked for once more."""
    for looked_for in (code_cache.directory_for, code_cache.read_only_directories_for, code_cache._key_of):
        looked_for.cache_clear()


@helper
def add_one(x):
    return x + 1


def add_two(x):
    return add_one(x) + add_one(x) - x


def add_to(numbers, by):
    numbers, by = value_of(numbers), value_of(by)
    for i in range(numbers.size):
        numbers[i] += add_one(by) - 1


def anew(function: Any) -> Any:
    """The same function once more, as another process would find it."""
    again = FunctionType(function.__code__, function.__globals__, function.__name__)
    again.__module__, again.__qualname__ = function.__module__, function.__qualname__
    return again


def compile_entry() -> None:
    compiled = entry(anew(add_two))
    compile_for(compiled, 1)
    assert compiled(5) == 7


def compile_native() -> None:
    numbers = np.zeros(3)
    behind, by = Behind(numbers), Behind(2.0)
    address, *values = NativeFunction(anew(add_to)).call_on(behind, by)
    ctypes.CFUNCTYPE(None, ctypes.c_uint64, ctypes.c_uint64)(address)(*values)
    assert numbers.tolist() == [2.0] * 3


NATIVE_NAME = f"{__name__.rpartition('.')[2]}.add_to"
NAMES = {compile_entry: "add_two", compile_native: NATIVE_NAME}
EITHER = pytest.mark.parametrize("compile_it", NAMES)


def told_by(compile_it: Callable[[], Any]) -> list[str]:
    """The functions whose compilation is reported."""
    told: list[str] = []
    with on_compilation(told.append):
        compile_it()
    return told


@EITHER
def test_each_function_is_reported_once_and_kept_code_never(compile_it: Callable[[], Any]) -> None:
    name = NAMES[compile_it]
    told = told_by(compile_it)
    assert told[0] == name
    assert sorted(set(told)) == sorted(told)
    assert set(told) <= {name, "add_one"}
    assert told_by(compile_it) == []


def test_code_of_this_process_is_not_reported_again() -> None:
    function = NativeFunction(anew(add_to))
    addresses = set()

    def compile_sizes() -> None:
        addresses.update(function.call_on(Behind(np.zeros(size)), Behind(2.0))[0] for size in (1, 2, 3))

    assert told_by(compile_sizes).count(NATIVE_NAME) == 1
    assert len(addresses) == 1


def test_a_closed_listener_hears_nothing() -> None:
    told = told_by(lambda: None)
    compile_entry()
    assert told == []


def test_every_open_listener_hears_every_function() -> None:
    inner: list[str] = []
    outer: list[str] = []
    with on_compilation(outer.append):
        with on_compilation(inner.append):
            compile_native()
        with compiling(add_to, "another"):
            pass
    assert outer == [*inner, "another"]
    assert inner[0] == NATIVE_NAME


def test_however_many_listen_interrupts_and_collector_are_then_as_they_were() -> None:
    before = signal.getsignal(signal.SIGINT)
    with on_compilation(lambda _: None), on_compilation(lambda _: None), on_compilation(lambda _: None):
        compile_native()
        compile_entry()
        assert signal.getsignal(signal.SIGINT) is before
    assert gc.isenabled()


def test_what_two_threads_compile_at_once_leaves_interrupts_as_they_were() -> None:
    """One begins first, and ends last."""
    before = signal.getsignal(signal.SIGINT)
    begun, ended = threading.Event(), threading.Event()

    def compile_beside() -> None:
        with compiling(add_to, "beside"):
            begun.set()
            ended.wait(60.0)

    with on_compilation(lambda _: None):
        with compiling(add_to, "here"):
            thread = threading.Thread(target=compile_beside)
            thread.start()
            assert begun.wait(60.0)
        assert signal.getsignal(signal.SIGINT) is before
        ended.set()
        thread.join()
    assert signal.getsignal(signal.SIGINT) is before


@EITHER
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_until_the_compilation_is_over(
    compile_it: Callable[[], Any], number: signal.Signals
) -> None:
    """And the next function is not begun."""
    told: list[str] = []

    def interrupt(name: str) -> None:
        if not told:
            signal.raise_signal(number)
        told.append(name)  # the interrupt did not break in here

    usual = signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
            compile_it()
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, usual)
    assert len(told) == 1
    compile_it()  # the compiler is in one piece


def test_one_that_comes_as_soon_as_interrupts_are_kept_is_kept_too(monkeypatch: pytest.MonkeyPatch) -> None:
    set_handler, before = signal.signal, signal.getsignal(signal.SIGINT)

    def set_and_interrupt(number: int, handler: Any) -> Any:
        old = set_handler(number, handler)
        if handler != before:
            signal.raise_signal(signal.SIGINT)
        return old

    told: list[str] = []
    monkeypatch.setattr(signal, "signal", set_and_interrupt)
    with pytest.raises(KeyboardInterrupt), on_compilation(told.append):
        compile_entry()
    assert len(told) == 1
    assert signal.getsignal(signal.SIGINT) == before
    compile_entry()


def test_an_interrupt_in_the_last_function_leaves_it_compiled() -> None:
    def interrupt(_name: str) -> None:
        signal.raise_signal(signal.SIGINT)

    function = entry(anew(add_one))
    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        compile_for(function, 1)
    assert told_by(lambda: function(1)) == []
    assert function(1) == 2


@EITHER
@pytest.mark.parametrize("is_on", [True, False])
def test_the_garbage_collector_rests_meanwhile_and_is_then_as_it_was(
    compile_it: Callable[[], Any], is_on: bool
) -> None:
    at_work: list[bool] = []
    was_on = gc.isenabled()
    (gc.enable if is_on else gc.disable)()
    try:
        with on_compilation(lambda _name: at_work.append(gc.isenabled())):
            compile_it()
        assert gc.isenabled() == is_on
    finally:
        (gc.enable if was_on else gc.disable)()
    assert at_work
    assert not any(at_work)


def test_what_fails_to_compile_leaves_interrupts_and_collector_as_they_were() -> None:
    def makes_an_array(x):
        return np.zeros(x)[0]

    before, was_on = signal.getsignal(signal.SIGINT), gc.isenabled()
    with on_compilation(lambda _name: None):
        for make in (lambda: entry(makes_an_array)(3), lambda: NativeFunction(makes_an_array).call_on(Behind(3))):
            with pytest.raises(Exception, match=r"NRT required|Failed in nopython mode"):
                make()
            assert signal.getsignal(signal.SIGINT) is before
            assert gc.isenabled() == was_on


def test_who_listens_may_fail_and_the_collector_is_on_again() -> None:
    def fail(_name: str) -> None:
        raise ValueError("not interested")

    was_on = gc.isenabled()
    with pytest.raises(ValueError, match="not interested"), on_compilation(fail):
        compile_native()
    assert gc.isenabled() == was_on
    compile_native()


def test_another_thread_compiles_without_a_hand_on_interrupts() -> None:
    """Only the main thread may set what a signal does."""
    told: list[str] = []
    with on_compilation(told.append):
        thread = threading.Thread(target=compile_native)
        thread.start()
        thread.join()
    assert told[0] == NATIVE_NAME


# --- how far it is ---


def test_shares_rise_and_stay_below_one() -> None:
    heard: list[tuple[str, float | None]] = []
    counted = Counted(lambda name, share: heard.append((name, share)))
    counted.expect(3)
    counted.expect(2)
    for i in range(8):
        counted.add(f"f{i}")
    assert [name for name, _ in heard] == [f"f{i}" for i in range(8)]
    shares = [share for _, share in heard if share is not None]
    assert shares[:4] == [0.2, 0.4, 0.6, 0.8]
    assert sorted(shares) == shares
    assert len(shares) == 8
    assert shares[-1] < 1.0


def test_without_an_expected_number_there_is_no_share() -> None:
    heard: list[float | None] = []
    counted = Counted(lambda _name, share: heard.append(share))
    counted.add("first")
    counted.expect(4)
    counted.add("second")
    assert heard == [None, 0.5]


def test_several_threads_may_count() -> None:
    heard: list[float | None] = []
    counted = Counted(lambda _name, share: heard.append(share))
    counted.expect(1000)
    threads = [threading.Thread(target=lambda: [counted.add("one") for _ in range(100)]) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == [i / 1000 for i in range(1, 801)]


# --- machine code that is damaged, cannot be written, or goes away ---


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def overwrite(file: Path) -> None:
    """In the middle, where the machine code is."""
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
    assert NAMES[compile_it] in told_by(compile_it)
    assert told_by(compile_it) == []


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
    assert told_by(compile_it) == []


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
def test_a_cache_that_is_removed_is_made_again(cache: Path, compile_it: Callable[[], Any]) -> None:
    compile_it()
    shutil.rmtree(cache / "hapsim")
    assert NAMES[compile_it] in told_by(compile_it)
    assert told_by(compile_it) == []


@EITHER
def test_code_that_cannot_be_written_is_compiled_all_the_same_and_kept_later(compile_it: Callable[[], Any]) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))  # as on a full disk
    try:
        assert NAMES[compile_it] in told_by(compile_it)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert NAMES[compile_it] in told_by(compile_it)
    assert told_by(compile_it) == []


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
        assert name in told_by(compile_it)


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
    assert told_by(compile_entry) == []
    assert kept.directory_of_kept_code(found=True) == image
    assert NAMES[compile_native] in told_by(compile_native)
    assert told_by(compile_native) == []
    assert files_in(image) == before
    assert {file.suffix for file in files_in(cache / "hapsim")} == {".nbi", ".nbc", ".kept"}


def test_code_that_others_could_have_written_is_not_used(image: Path) -> None:
    image.chmod(0o777)
    assert told_by(compile_entry) != []


def test_damage_in_a_read_only_cache_is_compiled_elsewhere(image: Path) -> None:
    overwrite(next(image.rglob("*.nbc")))
    before = files_in(image)
    assert told_by(compile_entry) != []
    assert told_by(compile_entry) == []
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
from importlib import import_module
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
of_test = import_module({__name__!r})
for compile_it in of_test.NAMES:
    print(compile_it.__name__, of_test.told_by(compile_it))
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


def test_what_prevents_compilation_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "address_space_limit", lambda: 512_000_000)
    for compile_it in NAMES:
        with pytest.raises(UsageError, match="address space is limited to 512 MB"):
            compile_it()
    monkeypatch.setattr(kept.numba.config, "DISABLE_JIT", 1)
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT in the environment prevents: unset it"):
        compile_native()
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT"):
        is_kept(add_two, 1)
