"""The border of a region of the K,B plane that a yes or a no defines, to the last digit that a picture has."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapsim.theory.arrays import Bools, Floats

_HALVINGS = 14  # of a mesh's side: far less than a dot of the picture

Judge = Callable[[Floats, Floats], Bools]


def border(judge: Judge, K: Floats, B: Floats) -> list[tuple[Floats, Floats]]:
    """Closed outlines (K, B) of the parts of a mesh (rows, columns) where `judge` says yes; a hole is an outline too.

    Traced from point to point; then each is moved along the side of the mesh that it lies on, by bisection.
    """
    from matplotlib.figure import Figure

    inside = judge(K, B)
    if not inside.any():
        return []
    along_K, along_B = K[0], B[:, 0]
    traced = Figure().add_subplot().contourf(inside.astype(float), levels=[0.5, 1.5])
    outlines = [np.asarray(ring) for path in traced.get_paths() for ring in path.to_polygons(closed_only=True)]
    return [_refined(judge, inside, along_K, along_B, ring) for ring in outlines]


def _refined(judge: Judge, inside: Bools, along_K: Floats, along_B: Floats, ring: Floats) -> tuple[Floats, Floats]:
    """A ring of mesh indices, those halfway between two points moved to where the judgement changes."""
    column, row = ring.T
    low = np.floor(row).astype(int), np.floor(column).astype(int)
    high = np.ceil(row).astype(int), np.ceil(column).astype(int)
    yes_is_low = inside[low]
    K_yes, K_no = along_K[np.where(yes_is_low, low[1], high[1])], along_K[np.where(yes_is_low, high[1], low[1])]
    B_yes, B_no = along_B[np.where(yes_is_low, low[0], high[0])], along_B[np.where(yes_is_low, high[0], low[0])]
    for _ in range(_HALVINGS):
        K, B = 0.5 * (K_yes + K_no), 0.5 * (B_yes + B_no)
        yes = judge(K, B)
        K_yes, B_yes = np.where(yes, K, K_yes), np.where(yes, B, B_yes)
        K_no, B_no = np.where(yes, K_no, K), np.where(yes, B_no, B)
    return K_yes, B_yes
