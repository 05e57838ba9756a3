"""System calls for compiled code: clock, sleep, wait, read, write (Linux, 64 bit), and the processor's denormals.

`numba.types.ExternalFunction` is internal to numba and used in this file alone. Unlike with a ctypes pointer, the
compiled code can be kept on disk. Structures are int64 or int32 arrays in the layout of the C library.
"""

from __future__ import annotations

import ctypes
import platform
import sys
import time
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hapsim.compiling import inlined, overload
from hapsim.errors import UsageError
from hapsim.loop.endings import FAILED, HUNG_UP, TIMED_OUT

SCRATCH = ("scratch", np.int64, (4,))
"""Field of a record for the structures of system calls, so that nothing is allocated."""

LARGEST_DATAGRAM = 1500
"""Bytes of the largest datagram that Ethernet carries whole."""

_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1
_EINTR = 4
_EAGAIN = 11
_POLLIN, _POLLOUT, _POLLHUP, _POLLERR, _POLLNVAL = 0x1, 0x4, 0x10, 0x8, 0x20

_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.uintp))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.uintp, types.uintp)
)
_ppoll = types.ExternalFunction("ppoll", types.int32(types.uintp, types.uint64, types.uintp, types.uintp))
_read = types.ExternalFunction("read", types.intp(types.int32, types.uintp, types.uintp))
_write = types.ExternalFunction("write", types.intp(types.int32, types.uintp, types.uintp))
_errno_location = types.ExternalFunction("__errno_location", types.CPointer(types.int32)())

CALLS = tuple(call.symbol for call in (_clock_gettime, _clock_nanosleep, _ppoll, _read, _write, _errno_location))
"""Names of these functions in the C library."""


def missing_calls() -> list[str]:
    """Returns those of CALLS that the C library lacks. Compiling a missing call would end the process."""
    try:
        library = ctypes.CDLL(None)
    except (OSError, TypeError):  # Windows has no such library
        return list(CALLS)
    return [name for name in CALLS if not hasattr(library, name)]


def require_linux(what: str, instead: str) -> None:
    """Raises UsageError if a call is missing. `what`: the subject that takes Linux. `instead`: the alternative."""
    missing = missing_calls()
    if missing:
        raise UsageError(f"{what} takes Linux; this system ({sys.platform}) has no {', '.join(missing)}: {instead}")


def now_ns(scratch):  # noqa: ARG001
    """Returns the monotonic time in ns. `scratch`: the caller's SCRATCH. In plain Python this is Python's own clock."""
    return time.monotonic_ns()


def sleep_until(deadline_ns, scratch):  # noqa: ARG001
    """Sleeps until an absolute monotonic time (ns); a past one costs no system call. In plain Python, by `time`."""
    time.sleep(max(deadline_ns - time.monotonic_ns(), 0) * 1e-9)


@overload(now_ns)
def _compiled_now_ns(scratch):  # noqa: ARG001
    def read_clock(scratch):
        _clock_gettime(_CLOCK_MONOTONIC, scratch.ctypes.data)
        return scratch[0] * 1_000_000_000 + scratch[1]

    return read_clock


@overload(sleep_until)
def _compiled_sleep_until(deadline_ns, scratch):  # noqa: ARG001
    def _sleep(deadline_ns, scratch):
        while now_ns(scratch) < deadline_ns:
            scratch[0] = deadline_ns // 1_000_000_000
            scratch[1] = deadline_ns % 1_000_000_000
            # Returns its error number instead of setting errno; after a signal it sleeps on.
            if _clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, scratch.ctypes.data, 0) not in (0, _EINTR):
                return

    return _sleep


@inlined
def _wait(descriptor, events, timeout_ns, scratch):
    """Waits for `events`. Returns those that occurred, 0 after the timeout, a negative code on failure."""
    timeout_ns = timeout_ns if timeout_ns > 0 else 0
    scratch[0] = timeout_ns // 1_000_000_000
    scratch[1] = timeout_ns % 1_000_000_000
    scratch[2] = descriptor | (events << 32)  # struct pollfd {int fd; short events; short revents;}
    ready = _ppoll(scratch.ctypes.data + 16, 1, scratch.ctypes.data, 0)
    if ready < 0:
        return TIMED_OUT if _errno_location()[0] == _EINTR else FAILED
    return (scratch[2] >> 48) & 0xFFFF


@inlined
def wait_for_any(polled, count, timeout_ns, scratch):
    """Waits until bytes have come, or the other side hung up, at one of `count` descriptors in `polled`, int64."""
    timeout_ns = timeout_ns if timeout_ns > 0 else 0
    scratch[0] = timeout_ns // 1_000_000_000
    scratch[1] = timeout_ns % 1_000_000_000
    for i in range(np.uint64(count)):
        polled[i] = (polled[i] & 0xFFFFFFFF) | (_POLLIN << 32)
    _ppoll(polled.ctypes.data, count, scratch.ctypes.data, 0)


@inlined
def has_news(polled):
    """Returns whether `wait_for_any` found something at this descriptor of its own."""
    return (polled >> 48) & 0xFFFF != 0


@inlined
def read_some(descriptor, buffer, timeout_ns, scratch):
    """Reads the available bytes into a buffer within `timeout_ns`. Returns their count, or a code of endings.py."""
    seen = _wait(descriptor, _POLLIN, timeout_ns, scratch)
    if seen <= 0:
        return seen
    if seen & _POLLNVAL:
        return FAILED
    if not seen & _POLLIN:
        return HUNG_UP
    count = _read(descriptor, buffer.ctypes.data, buffer.size)
    if count > 0:
        return count
    if count == 0:
        # With VMIN = 1 an empty port reads as EAGAIN, so an empty read means that the other side hung up.
        return HUNG_UP
    error = _errno_location()[0]
    if error in (_EINTR, _EAGAIN):
        return TIMED_OUT
    return HUNG_UP if seen & (_POLLHUP | _POLLERR) else FAILED


@inlined
def read_datagrams(descriptor, buffer, timeout_ns, scratch):
    """Reads the available datagrams into a buffer within `timeout_ns`. Returns the count of their bytes, or a code of
    endings.py."""
    seen, count = _wait(descriptor, _POLLIN, timeout_ns, scratch), 0
    if seen <= 0:
        return seen
    if seen & _POLLNVAL:
        return FAILED
    while buffer.size - count >= LARGEST_DATAGRAM:
        one = _read(descriptor, buffer.ctypes.data + count, buffer.size - count)
        if one < 0:
            # A machine on which nothing listens refuses datagrams.
            is_gone = count == 0 and _errno_location()[0] not in (_EINTR, _EAGAIN)
            return HUNG_UP if is_gone else count if count > 0 else TIMED_OUT
        if one == 0 and seen & _POLLHUP:  # and no empty datagram
            return HUNG_UP
        count += one
    return count


@inlined
def write_some(descriptor, buffer, start, stop):
    """Writes as much of buffer[start:stop] as fits, without waiting. Returns the count, or HUNG_UP."""
    if start == stop:
        return 0
    count = _write(descriptor, buffer.ctypes.data + start, stop - start)
    if count >= 0:
        return count
    return 0 if _errno_location()[0] in (_EINTR, _EAGAIN) else HUNG_UP


@inlined
def write_all(descriptor, buffer, stop, timeout_ns, scratch):
    """Writes buffer[:stop]. Returns 0, HUNG_UP, or FAILED if not all fits within `timeout_ns`."""
    at = give_up = 0
    while at < stop:
        count = write_some(descriptor, buffer, at, stop)
        if count < 0:
            return HUNG_UP
        at += count
        if count > 0:
            continue
        give_up = now_ns(scratch) + timeout_ns if give_up == 0 else give_up
        if _wait(descriptor, _POLLOUT, give_up - now_ns(scratch), scratch) < 0 or now_ns(scratch) >= give_up:
            return FAILED
    return 0


# Denormals, floating-point numbers below 1e-307, count as zero while a loop runs. A string at rest is full of them, and
# arithmetic with them takes many times as long: a scene would become slow as it becomes silent. This is a mode of the
# processor for each thread. The loop restores it at its end: the rest of the program may rely on such numbers.

ir = cgutils.ir

_FLUSH_TO_ZERO, _DENORMALS_ARE_ZERO = 1 << 15, 1 << 6  # of the control register of SSE and AVX
_HAS_REGISTER = platform.machine() in ("x86_64", "AMD64")


@intrinsic
def flush_denormals(_typing: Any) -> Any:
    """Sets the mode for the calling thread; returns the old one for `restore_denormals`. Does nothing except on x86."""

    def _generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if not _HAS_REGISTER:
            return context.get_constant(types.uint32, 0)
        register = cgutils.alloca_once(builder, ir.IntType(32))
        _call_on_register(builder, "stmxcsr", register)
        before = builder.load(register)
        builder.store(builder.or_(before, before.type(_FLUSH_TO_ZERO | _DENORMALS_ARE_ZERO)), register)
        _call_on_register(builder, "ldmxcsr", register)
        return before

    return types.uint32(), _generate


@intrinsic
def restore_denormals(_typing: Any, mode: Any) -> Any:  # noqa: ARG001
    """Restores the mode of the calling thread."""

    def _generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        if _HAS_REGISTER:
            register = cgutils.alloca_once_value(builder, arguments[0])
            _call_on_register(builder, "ldmxcsr", register)
        return context.get_dummy_value()

    return types.void(types.uint32), _generate


def _call_on_register(builder: Any, instruction: str, register: Any) -> None:
    bytes_of_it = builder.bitcast(register, ir.IntType(8).as_pointer())
    access = ir.FunctionType(ir.VoidType(), [bytes_of_it.type])
    function = cgutils.get_or_insert_function(builder.module, access, f"llvm.x86.sse.{instruction}")
    builder.call(function, [bytes_of_it])
