"""Values and functions behind addresses: what goes there comes out as it was, and what would not is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core import types

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import (
    Behind,
    NativeFunction,
    address_in_memory,
    address_of,
    array_at,
    function_at,
    native,
    record_at,
    value_of,
)

INNER = np.dtype([("count", np.int64), ("share", np.float64)], align=True)
RECORD = np.dtype([("flag", np.uint8), ("inner", INNER), ("row", np.float32, (3,)), ("end", np.int64)], align=True)


class Ends(NamedTuple):
    first: Any
    second: Any


class Links(NamedTuple):
    ends: Ends
    stiffness: Any
    number: Any
    matrix: Any
    gains: tuple[Any, Any, Any]
    share: Any
    record: Any


_call = function_at(types.void(types.uint64, types.uint64, types.uint64))


@entry
def call_compiled(function, value, out):
    _call(function, (value, out, out))


def through(function: Callable[..., None], value: Any, out: np.ndarray) -> np.ndarray:
    """Returns `out` after a call of a compiled function from compiled code, with all arguments behind addresses."""
    # Who has the objects keeps what is behind the addresses.
    behind, target = Behind(value), Behind(out)
    address, *arguments = NativeFunction(function).call_on(behind, target, target)
    call_compiled(address, *arguments[:2])
    return out


def copy_number(value, out, _same):
    value, out = value_of(value), value_of(out)
    out[0] = value


@pytest.mark.parametrize(
    "value",
    [0, -1, 2**63 - 1, -(2**63), 2**63, 2**64 - 1, np.int64(-7), np.uint64(2**64 - 7)],
    ids=lambda value: f"{type(value).__name__} {value}",
)
def test_a_whole_number_comes_out_as_it_went_in(value: Any) -> None:
    out = through(copy_number, value, np.zeros(1, np.uint64 if value >= 2**63 else np.int64))
    assert int(out[0]) == int(value)


@pytest.mark.parametrize("value", [0.1, -0.0, 5e-324, np.inf, np.nan, np.float64(-1.7e308)], ids=str)
def test_a_number_comes_out_with_every_bit(value: float) -> None:
    assert through(copy_number, value, np.zeros(1)).tobytes() == np.float64(value).tobytes()


def copy_row(value, out, _same):
    value, out = value_of(value), value_of(out)
    for i in range(value.size):
        out[i] = value[i]


def copy_rows(value, out, _same):
    value, out = value_of(value), value_of(out)
    for i in range(value.shape[0]):
        for j in range(value.shape[1]):
            out[i, j] = value[i, j]
            # By its row, and by all of it as one row: what is behind the address is contiguous.
            if value[i][j] != value[i, j] or value.size != value.shape[0] * value.shape[1]:
                out[i, j] = 0


DTYPES = [np.float64, np.float32, np.int64, np.uint32, np.bool_]


@pytest.mark.parametrize("dtype", DTYPES, ids=lambda dtype: dtype.__name__)
@pytest.mark.parametrize("shape", [(5,), (0,), (3, 4), (1, 3), (2, 0)], ids=str)
def test_an_array_comes_out_with_its_shape_and_every_number(dtype: Any, shape: tuple[int, ...]) -> None:
    value = np.random.default_rng(1).integers(1, 255, shape).astype(dtype)
    out = through(copy_row if len(shape) == 1 else copy_rows, value, np.zeros(shape, dtype))
    np.testing.assert_array_equal(out, value)


def double(value, _out, _same):
    value = value_of(value)
    for i in range(value.size):
        value[i] = value[i] + value[i]


def test_what_is_written_there_is_written_in_the_array_itself() -> None:
    value = np.arange(4.0)
    through(double, value[1:], np.zeros(1))
    np.testing.assert_array_equal(value, [0.0, 2.0, 4.0, 6.0])


def copy_record(value, out, _same):
    value, out = value_of(value), value_of(out)
    out[0] = value.flag
    out[1] = value.inner.count
    out[2] = value.inner.share
    out[3] = value.row[2]
    value.inner.share = 0.25
    value.end = 7


def test_a_record_is_the_same_on_either_side() -> None:
    record = new_record(RECORD)
    record.flag, record.inner.count, record.inner.share, record.row[2] = 200, -3, 0.5, 1.5
    np.testing.assert_array_equal(through(copy_record, record, np.zeros(4)), [200.0, -3.0, 0.5, 1.5])
    assert (record.inner.share, record.end) == (0.25, 7)
    inner = new_record(RECORD)
    inner.inner.share = 0.125
    assert through(copy_share, inner.inner, np.zeros(1))[0] == 0.125


def copy_share(value, out, _same):
    value, out = value_of(value), value_of(out)
    out[0] = value.share


def copy_records(value, out, _same):
    value, out = value_of(value), value_of(out)
    for i in range(value.size):
        out[i] = value[i].inner.count


def test_an_array_of_records_comes_out_one_by_one() -> None:
    records = np.zeros(3, RECORD)
    records["inner"]["count"] = [4, 5, 6]
    np.testing.assert_array_equal(through(copy_records, records, np.zeros(3, np.int64)), [4, 5, 6])


def copy_links(links, out, _same):
    links, out = value_of(links), value_of(out)
    first, second, third = links.gains
    out[0] = links.ends.first[1]
    out[1] = links.ends.second[0]
    out[2] = links.stiffness[2]
    out[3] = links.number
    out[4] = links.matrix[1, 2]
    out[5] = first[0] + second[1] + third
    out[6] = links.share
    out[7] = links.record.inner.count
    links.stiffness[0] = 9.0


def test_named_tuples_of_all_these_come_out_field_by_field() -> None:
    """Arrays of one and two dimensions take up a different number of words: no field is taken for another."""
    record = new_record(RECORD)
    record.inner.count = 11
    links = Links(
        ends=Ends(np.array([1, 2], np.uint32), np.array([3, 4], np.uint32)),
        stiffness=np.array([5.0, 6.0, 7.0], np.float32),
        number=np.uint64(8),
        matrix=np.arange(6.0).reshape(2, 3),
        gains=(np.array([0.5]), np.array([0.0, 0.25]), 0.125),
        share=-0.75,
        record=record,
    )
    out = through(copy_links, links, np.zeros(8))
    np.testing.assert_array_equal(out, [2.0, 3.0, 7.0, 8.0, 5.0, 0.875, -0.75, 11.0])
    assert links.stiffness[0] == 9.0


def test_one_function_serves_values_of_several_types() -> None:
    function = NativeFunction(copy_number)
    out = Behind(np.zeros(1))
    addresses = {function.call_on(Behind(value), out, out)[0] for value in (1, 2, 1.0, np.uint64(1))}
    assert len(addresses) == 3  # both integers are of one type


def misaligned() -> np.ndarray:
    return np.zeros(17, np.uint8)[1:].view(np.float64)


REFUSED = {
    "list": [1.0, 2.0],
    "text": "text",
    "nothing": None,
    "list in a tuple": (1, [2]),
    "every other number": np.zeros(6)[::2],
    "transposed": np.zeros((2, 3)).T,
    "column by column": np.asfortranarray(np.zeros((2, 3))),
    "columns cut off": np.zeros((2, 3))[:, :2],
    "every other number in a named tuple": Ends(np.zeros(2), np.zeros(4)[::2]),
    "alignment": misaligned(),
    "number of 32 bits": np.float32(1.0),
    "complex number": 1j,
    # Whole numbers of another size would be read as 64 bits of another type.
    "bool": True,
    "int32": np.int32(5),
    "uint32": np.uint32(5),
    "uint8": np.uint8(5),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_does_not_go_behind_an_address_is_refused(what: str) -> None:
    with pytest.raises(TypeError):
        Behind(REFUSED[what])


# --- addresses as numbers ---

_record_at, _doubles_at = record_at(RECORD), array_at(np.float64)


@native(types.float64, types.uint64, types.uint64, types.int64)
def read_both(record, numbers, count):
    record, numbers = _record_at(record), _doubles_at(numbers, count)
    total = np.float64(record.inner.count)
    for i in range(numbers.size):
        total += numbers[i]
    record.end = count
    return total


_call_read_both = function_at(types.float64(types.uint64, types.uint64, types.int64))


@entry
def read_by_address(function, record, numbers):
    return _call_read_both(function, (address_in_memory(record), np.uint64(numbers.ctypes.data), numbers.size))


def test_records_and_arrays_are_found_by_their_addresses() -> None:
    record, numbers = new_record(RECORD), np.array([1.0, 2.5])
    record.inner.count = 3
    assert read_both(address_of(record), address_of(numbers), 2) == 6.5
    assert record.end == 2
    assert read_by_address(np.uint64(read_both.address()), record, numbers[1:]) == 5.5
    assert record.end == 1


def test_a_record_in_a_record_has_an_address_of_its_own() -> None:
    record = new_record(RECORD)
    assert address_of(record.inner) == address_of(record) + RECORD.fields["inner"][1]


def test_a_new_record_is_zero_and_stays_where_it_is() -> None:
    record = new_record(RECORD)
    assert bytes(record.tobytes()) == bytes(RECORD.itemsize)
    record.inner = new_record(INNER)
    where = address_of(record)
    record.inner.count = 5
    assert address_of(record) == where
    assert record["inner"]["count"] == 5


def test_a_record_has_its_fields_as_attributes_and_those_of_the_records_in_it() -> None:
    inner = np.dtype([("count", np.int64), ("places", np.float64, 2)])
    record = new_record(np.dtype([("inner", inner), ("several", inner, 3), ("value", np.float64)], align=True))
    record.value, record.inner.count, record.several[1].places[:] = 0.5, 7, (1.0, 2.0)
    assert (record["value"], record["inner"]["count"], record.several["places"].sum()) == (0.5, 7, 3.0)
    with pytest.raises(AttributeError, match="no field 'valeu'"):
        record.valeu  # noqa: B018
    with pytest.raises(AttributeError, match="no field 'valeu'"):
        record.valeu = 1.0
