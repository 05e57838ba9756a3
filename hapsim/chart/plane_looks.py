"""How the pictures of the K,B plane look, of one mass and of several: every colour of them, with its width and dashes.

Greys are from 0 (black) to 1 (white). What lies further up has the larger zorder.
"""

from __future__ import annotations

from typing import Any

Look = dict[str, Any]

UNSTABLE: Look = {"facecolor": "0.80", "linewidth": 0, "zorder": 0.5}
UNSTABLE_WITH_SOME_MASS: Look = {"facecolor": "0.92", "linewidth": 0, "zorder": 0.5}
NO_EQUIVALENT: Look = {"facecolor": "0.92", "linewidth": 0, "zorder": 0.4}
PASSIVE: Look = {"facecolor": "none", "edgecolor": "0.5", "linewidth": 0.8, "hatch": "////", "zorder": 1.6}

IDEAL: Look = {"color": "0.78", "linewidth": 0.6, "zorder": 1}
ISO: dict[str, Look] = {
    "iso_k": {"color": "0.15", "linewidth": 1.0, "zorder": 2},
    "iso_b": {"color": "0.15", "linewidth": 1.0, "dashes": (5, 2), "zorder": 2},
}
LINEAR: Look = {"color": "0.35", "linewidth": 0.9, "dashes": (2, 2), "zorder": 2.4}
FOLD: Look = {"color": "black", "linewidth": 1.4, "dashes": (6, 2, 1, 2), "zorder": 2.5}
LIMIT: Look = {"color": "black", "linewidth": 2.4, "zorder": 3}
OPERATING_POINT: Look = {
    "marker": "o",
    "linestyle": "",
    "markersize": 7,
    "markerfacecolor": "black",
    "markeredgecolor": "white",
    "zorder": 6,
    "clip_on": False,
}

OF_MASS: tuple[Look, ...] = (
    {"color": "black"},
    {"color": "0.35", "dashes": (6, 2)},
    {"color": "0.5", "dashes": (1.5, 1.5)},
    {"color": "0.2", "dashes": (6, 2, 1.5, 2)},
    {"color": "0.6", "dashes": (10, 3)},
)
"""Of several masses: one for each, of its stability limit and of its curves of equal k and b."""
LIMIT_OF_MASS: Look = {"linewidth": 2.4, "zorder": 3}
ISO_OF_MASS: dict[str, Look] = {"iso_k": {"linewidth": 1.0, "zorder": 2}, "iso_b": {"linewidth": 0.7, "zorder": 2}}
ISO_IN_LEGEND: Look = {"color": "black", "linewidth": 1.0}

ZERO_MARK: Look = {"color": "black", "linewidth": 0.8}
NUMBER_BOX: Look = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
WORDS_BOX: Look = {"facecolor": "white", "edgecolor": "0.4", "linewidth": 0.5, "pad": 2.5}
