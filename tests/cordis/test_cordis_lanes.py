"""Memory layout of structures, and single numbers in SIMD lanes."""

from __future__ import annotations

import numpy as np
import pytest

from hapsim.compiling import entry
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.cordis.simd import BYTES, WIDEST, add_to_one, aligned, padded, put_one
from hapsim.scene import Scene


def test_what_is_padded_fills_lanes_and_no_more() -> None:
    for count in range(1, 100):
        assert padded(count) % WIDEST == 0
        assert count <= padded(count) < count + WIDEST


@pytest.mark.parametrize("precision", ["double", "single"])
def test_every_structure_begins_where_lanes_may_and_ends_in_its_own(precision: str) -> None:
    modules = {"hand": {"type": "device", "channel": 0}, "ball": {"type": "mass", "mass": 1.0}}
    values = {"mass": 0.001, "stiffness": 10.0}
    modules |= {f"s{n}": {"type": "string", "masses": n, **values} for n in (5, 14, 15, 16)}
    modules |= {f"b{n}": {"type": "string", "masses": n, "bending": 1.0, **values} for n in (5, 12, 13, 16)}
    modules |= {f"m{n}": {"type": "membrane", "rows": 3, "columns": n, **values} for n in (5, 14, 15)}
    scene = Scene.model_validate(
        {"version": 1, "rate": 1000, "precision": precision, "device": {"mass": 0.2}, "modules": modules}
    )
    rows, number = compile_scene(scene).rows, numbers_of(scene)
    assert all(row.ctypes.data % BYTES == 0 for row in rows)
    for name, structure in scene.structures.items():
        assert number[f"{name}.{structure.point_names()[0]}"] % WIDEST == (1 if name.startswith("m") else 2)
    lanes: dict[int, str] = {}
    for point, at in number.items():
        owner = point.partition(".")[0] if "." in point else ""
        assert lanes.setdefault(at // WIDEST, owner) == owner


@entry
def put_and_add(row, i, number, more):
    put_one(row, np.uint64(i), number)
    add_to_one(row, np.uint64(i), more)


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_one_number_is_put_and_added_to_and_none_next_to_it(real: type) -> None:
    rng = np.random.default_rng(1)
    before = rng.normal(size=3 * WIDEST)
    for i in range(before.size):
        row = aligned(before, real)
        put_and_add(row, i, real(0.1), real(0.2))
        expected: np.ndarray = before.astype(real)
        expected[i] = real(0.1) + real(0.2)
        np.testing.assert_array_equal(row, expected)
