"""Nothing is allocated in the hot path, and no array outlives the call that brought it: references are not counted.

What tries to all the same does not compile; and nothing in our sources tries, compiled yet or not.
"""

from __future__ import annotations

import ast
import builtins
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.errors import NumbaError

from hapsim.compiling import entry, fma, helper, inlined, reassociated
from hapsim.compiling.native import Behind, NativeFunction, value_of

# --- the compiler refuses it ---


ALLOCATING = {
    "zeros": "made = np.zeros(3); made[0] = numbers[0]; numbers[1] = made[0] + made[1]",
    "empty": "made = np.empty(3); made[0] = numbers[0]; numbers[1] = made[0]",
    "copy": "numbers[1] = numbers.copy()[0]",
    "conversion": "numbers[1] = numbers.astype(np.float32)[0]",
    "sum of arrays": "numbers[1] = (numbers + numbers)[0]",
    "product of arrays": "numbers[:] = 2.0 * numbers",
    "list": "made = [numbers[0], numbers[1]]; numbers[1] = made[int(numbers[2])]",
    "set": "numbers[1] = len({numbers[0], numbers[2]})",
    "array of a list": "numbers[1] = np.array([numbers[0], numbers[2]])[0]",
    "concatenation": "numbers[1] = np.concatenate((numbers, numbers))[0]",
    "returned array": "made = np.zeros(3); made[0] = numbers[0]; return made",
    "returned view": "return numbers[1:]",
}
HARMLESS = "part = numbers[1:]\n    for i in range(part.size): part[i] += numbers[0]"


def function_of(body: str) -> Any:
    """A new function, of which numba knows nothing yet."""
    names: dict[str, Any] = {"np": np, "__name__": __name__}
    exec(compile(f"def function(numbers):\n    {body}", __file__, "exec"), names)
    return names["function"]


def by_piece(decorator: Callable[[Any], Any]) -> Callable[[Any], None]:
    def compile_in_entry(function: Any) -> None:
        piece = decorator(function)

        def call(numbers):
            piece(numbers)

        entry(call)(np.ones(3))

    return compile_in_entry


def as_native(function: Any) -> None:
    piece = inlined(function)

    def call(numbers):
        piece(value_of(numbers))

    NativeFunction(call).call_on(Behind(np.ones(3)))


#: How a function of the hot path is compiled, for three numbers.
WAYS: dict[str, Callable[[Any], None]] = {
    "entry": lambda function: entry(function)(np.ones(3)),
    "inlined": by_piece(inlined),
    "helper": by_piece(helper),
    "fma": by_piece(fma),
    "reassociated": by_piece(reassociated),
    "native": as_native,
}


@pytest.mark.parametrize("way", WAYS)
def test_what_allocates_nothing_compiles(way: str) -> None:
    WAYS[way](function_of(HARMLESS))


@pytest.mark.parametrize(
    ("way", "what"),
    [("entry", each) for each in ALLOCATING]
    + [(way, each) for way in WAYS if way != "entry" for each in ("zeros", "returned view")],
)
def test_what_makes_an_array_or_lets_one_out_does_not_compile(way: str, what: str) -> None:
    with pytest.raises(NumbaError, match=r"NRT required but not enabled|Only accept returning of array passed into"):
        WAYS[way](function_of(ALLOCATING[what]))


# --- our sources do not try ---

DISPLAYS = (ast.List, ast.ListComp, ast.Set, ast.SetComp, ast.Dict, ast.DictComp, ast.GeneratorExp, ast.JoinedStr)
OTHERS = (ast.Lambda, ast.Raise, ast.Try, ast.With, ast.Yield, ast.YieldFrom, ast.Global, ast.Nonlocal)

#: What the hot path calls of others: conversions of one number, and mathematics of one number.
BUILT_IN = {"range", "abs", "min", "max"}
OF_NUMPY = {"uint64", "int64", "uint32", "float32", "float64", "rint", "floor", "ceil"}
METHODS = {"type", "view"}  # of an array's dtype, and of one number


def allocations_in(function: ast.FunctionDef, theirs: set[str]) -> Iterator[str]:
    """Yields the expressions of a function that allocate, or are not known not to. `theirs`: names imported from other
    packages."""
    for node in (node for statement in function.body for node in ast.walk(statement)):
        if isinstance(node, (*DISPLAYS, *OTHERS)):
            yield ast.unparse(node)
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        if isinstance(called, ast.Name):
            known = called.id not in theirs and (called.id in BUILT_IN or not hasattr(builtins, called.id))
        else:
            assert isinstance(called, ast.Attribute), ast.unparse(node)
            of, name = ast.unparse(called.value), called.attr
            known = name in OF_NUMPY if of == "np" else of == "math" or name in METHODS
        if not known:
            yield ast.unparse(node)


@cache
def functions_of(file: Path) -> tuple[dict[int, ast.FunctionDef], set[str]]:
    """A source's functions by their first line, and the names that it has from packages that are not ours."""
    nodes = [*ast.walk(ast.parse(file.read_text(encoding="utf-8")))]
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    theirs = [node for node in imports if (node.module or "").partition(".")[0] not in ("hapsim", "firmware_protocol")]
    return (
        {min([node.lineno, *(by.lineno for by in node.decorator_list)]): node for node in functions},
        {alias.asname or alias.name for node in theirs for alias in node.names},
    )


def test_no_function_of_the_hot_path_allocates(every_compiled: list[Any]) -> None:
    found, looked_at = [], 0
    for one in every_compiled:
        if one.kind in ("intrinsic", "lowering"):
            continue  # these run while something is compiled
        functions, theirs = functions_of(one.file)
        looked_at += 1
        found += [f"{one}: {what}" for what in allocations_in(functions[one.line], theirs)]
    assert found == []
    assert looked_at > 150


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("made = np.zeros(3)", ["np.zeros(3)"]),
        ("made = zeros(3)", ["zeros(3)"]),
        ("state.force[:] = np.dot(a, b)", ["np.dot(a, b)"]),
        ("before = state.position.copy()", ["state.position.copy()"]),
        ("both = [a, b]", ["[a, b]"]),
        ("total = sum(state.force)", ["sum(state.force)"]),
        ("a[0] = np.float64(np.empty(1)[0])", ["np.empty(1)"]),
        (
            "if a > b:\n        raise ValueError('too large')",
            ["raise ValueError('too large')", "ValueError('too large')"],
        ),
        ("for i in range(np.uint64(a.size)):\n        b[i] = math.exp(-a[i]) + x.dtype.type(2) * pull(a, (i, i))", []),
    ],
)
def test_what_allocates_is_found(line: str, found: list[str]) -> None:
    function = ast.parse(f"def action(a, b):\n    {line}").body[0]
    assert isinstance(function, ast.FunctionDef)
    assert list(allocations_in(function, {"zeros"})) == found
