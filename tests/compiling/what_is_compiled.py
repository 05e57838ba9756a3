"""Prints, as JSON, every function in some folders that numba compiles, or that tells it how, and what each reaches.

A program of its own, because what tests have compiled is in their process too. `python what_is_compiled.py FOLDER...`
imports all that stands in the folders: a package by its name, other files as they are imported beside each other.
"""

from __future__ import annotations

import ast
import dis
import functools
import gc
import importlib
import inspect
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from numba.core import imputils
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.typing import templates

from firmware_protocol.lean_compiler import PieceType
from hapsim.compiling.native import NativeFunction

FOLDERS = [Path(argument).resolve() for argument in sys.argv[1:]]


def place_of(folder: Path) -> Path:
    """Returns the import path of a folder."""
    return folder.parent if (folder / "__init__.py").exists() else folder


def modules_in(folder: Path) -> Iterator[str]:
    """Yields the modules that may have compiled functions: those that name a compiler. The others load plots and
    filters."""
    for file in sorted(folder.rglob("*.py")):
        if not re.search("numba|compil|native|inlined|helper", file.read_text(encoding="utf-8")):
            continue
        parts = file.relative_to(place_of(folder)).with_suffix("").parts
        if parts[-1] != "__main__":
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def choosers() -> Iterator[tuple[Any, FunctionType]]:
    """Yields each target of numba's `overload` with the function that chooses its code."""
    for template in templates.builtin_registry.functions:
        chooser = getattr(template, "_overload_func", None)
        if chooser is not None:
            yield template.key, chooser


def compiled() -> Iterator[tuple[str, Any]]:
    pieces = {id(kind.dispatcher) for _, kind in templates.builtin_registry.globals if isinstance(kind, PieceType)}
    for one in gc.get_objects():
        if isinstance(one, Dispatcher):
            yield "piece" if id(one) in pieces else "entry", one.py_func
        elif isinstance(one, NativeFunction):
            yield "native", one.function
        elif isinstance(one, _Intrinsic):
            yield "intrinsic", one._defn
    for _, chooser in choosers():
        yield "overload", chooser
    for lowering, *_ in imputils.builtin_registry.functions:
        yield "lowering", inspect.unwrap(lowering)


def file_of(one: Any) -> str | None:
    """Returns the source file of one of hapsim's objects; None for others."""
    try:
        return our_file(inspect.getsourcefile(one) or "")
    except TypeError:
        return None


@functools.cache
def our_file(name: str) -> str | None:
    file = Path(name).resolve()
    return str(file) if any(file.is_relative_to(folder) for folder in FOLDERS) else None


@functools.cache
def imported_from(file: str) -> dict[str, str]:
    """The module that each name of a source was imported from."""
    return {
        alias.asname or alias.name: node.module or ""
        for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


@functools.cache
def names_in(code: CodeType) -> frozenset[tuple[str, str]]:
    """(how it is looked up, name) of all names in a function and in those that it makes."""
    looked_up = ("LOAD_GLOBAL", "LOAD_ATTR", "LOAD_METHOD")
    found = {(one.opname, str(one.argval)) for one in dis.get_instructions(code) if one.opname in looked_up}
    inside = [names_in(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return frozenset(found.union(*inside))


def reached_from(root: FunctionType) -> set[str]:
    """The files of ours whose functions and values the machine code of a function may be made of. What is chosen by
    type, out of a table, is not seen here."""
    chosen = {id(function): chooser for function, chooser in choosers()}
    ahead: list[Any] = [root]
    seen, files = set(), set()
    while ahead:
        one = ahead.pop()
        one = getattr(one, "py_func", getattr(one, "_defn", one))
        file = file_of(one)
        if file is None or id(one) in seen:
            continue
        seen.add(id(one))
        files.add(file)
        if not isinstance(one, FunctionType):
            continue
        if id(one) in chosen:
            ahead.append(chosen[id(one)])
        names = names_in(one.__code__)
        ahead += [cell.cell_contents for cell in one.__closure__ or ()]
        for name in {name for how, name in names if how == "LOAD_GLOBAL"} & set(one.__globals__):
            value = one.__globals__[name]
            ahead += [value, sys.modules.get(imported_from(file).get(name, ""))]
            if isinstance(value, ModuleType) and file_of(value):
                ahead += [getattr(value, each, None) for how, each in names if how != "LOAD_GLOBAL"]
    return files


def main() -> None:
    sys.path[:0] = [str(place_of(folder)) for folder in FOLDERS]
    missing = []
    for name in [name for folder in FOLDERS for name in modules_in(folder)]:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            missing.append((name, error.name))
    functions = {
        (kind, one.__qualname__, file_of(one), inspect.getsourcelines(one)[1]): one
        for kind, one in compiled()
        if file_of(one)
    }
    print(
        json.dumps(
            {
                "missing": missing,
                "functions": [
                    {"kind": key[0], "name": key[1], "file": key[2], "line": key[3]}
                    | ({"reached": sorted(reached_from(one))} if key[0] in ("entry", "native") else {})
                    for key, one in sorted(functions.items(), key=lambda item: item[0])
                ],
            }
        )
    )


if __name__ == "__main__":
    main()
