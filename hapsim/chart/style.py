"""Every colour, line width and dash of the pictures.

Greys run from 0 (black) to 1 (white); what has a larger zorder is on top.
"""

from __future__ import annotations

from typing import Any

Look = dict[str, Any]

# The K,B plane.
UNSTABLE: Look = {"facecolor": "0.80", "linewidth": 0, "zorder": 0.5}
UNSTABLE_WITH_SOME_MASS: Look = {"facecolor": "0.92", "linewidth": 0, "zorder": 0.5}
NO_EQUIVALENT: Look = {"facecolor": "0.92", "linewidth": 0, "zorder": 0.4}
PASSIVE: Look = {"facecolor": "none", "edgecolor": "0.5", "linewidth": 0.8, "hatch": "////", "zorder": 1.6}
IDEAL: Look = {"color": "0.78", "linewidth": 0.6, "zorder": 1}
ISO: dict[str, Look] = {"iso_k": {"linewidth": 1.0}, "iso_b": {"linewidth": 0.8}}
ISO_OF_ONE_MASS: dict[str, Look] = {"iso_k": {"color": "0.15"}, "iso_b": {"color": "0.15", "linestyle": (0, (5, 2))}}
LINEAR: Look = {"color": "0.35", "linewidth": 0.9, "dashes": (2, 2), "zorder": 2.4}
FOLD: Look = {"color": "black", "linewidth": 1.4, "dashes": (6, 2, 1, 2), "zorder": 2.5}
LIMIT: Look = {"linewidth": 2.4, "zorder": 3}
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
    {"color": "black", "linestyle": "-"},
    {"color": "0.35", "linestyle": (0, (6, 2))},
    {"color": "0.5", "linestyle": (0, (1.5, 1.5))},
    {"color": "0.2", "linestyle": (0, (6, 2, 1.5, 2))},
    {"color": "0.6", "linestyle": (0, (10, 3))},
)
"""Looks of several masses: one for each, of its stability boundary and of its curves."""
WORDS_BOX: Look = {"facecolor": "white", "edgecolor": "0.4", "linewidth": 0.5, "pad": 2.5}
NUMBER: Look = {
    "ha": "center",
    "va": "center",
    "fontsize": 8.5,
    "bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.8},
    "zorder": 2.2,
}

# Impedances over frequency.
DESIRED: Look = {"color": "0.5", "linewidth": 1.6, "dashes": (5, 2)}
RENDERED: Look = {"color": "black", "linewidth": 1.4}
MEASURED: Look = {
    "fmt": "o",
    "color": "#b3261e",
    "markersize": 4.0,
    "elinewidth": 0.9,
    "markerfacecolor": "white",
    "markeredgewidth": 0.9,
    "zorder": 3,
}
FELT: Look = {"color": "#2f7f9e", "linewidth": 1.4, "dashes": (7, 2, 1.5, 2)}
AGREES: Look = {"facecolor": "#2f7f9e", "alpha": 0.1, "linewidth": 0, "zorder": 0.4}
NOT_PASSIVE: Look = {"facecolor": "0.86", "linewidth": 0, "zorder": 0.5}
EIGENFREQUENCY: Look = {"color": "black", "linewidth": 0.9, "dashes": (2, 2), "zorder": 1.5}

# What is felt of what is desired: by outcome (the closer to the desired, the darker), and by correction.
OUTCOMES = ("#12355b", "#2f7f9e", "#9cc9c4", "#f3ead2", "#ffffff", "#c9c0b4", "#ffffff")
OUTCOME_HATCHES = {"OUT_OF_REACH": "//////", "UNSTABLE": "xxxxxx"}
HATCH = "0.45"
WITHIN: Look = {"facecolor": "0.5", "alpha": 0.12, "linewidth": 0, "zorder": 0.5}
SHARES: Look = {
    "fontsize": 8.5,
    "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.88, "pad": 2.0},
    "zorder": 6,
}
_SHARE_LINE: Look = {"markersize": 3.8, "linewidth": 1.3, "markevery": 0.09}
CORRECTIONS: dict[str, Look] = {
    "none": _SHARE_LINE | {"color": "#b3541e", "linestyle": (0, (1.2, 1.2)), "marker": "v"},
    "poles": _SHARE_LINE | {"color": "#4c9a8b", "linestyle": (0, (5, 1.6)), "marker": "s"},
    "sensed": _SHARE_LINE | {"color": "#8a5fa8", "linestyle": (0, (6, 1.4, 1.2, 1.4)), "marker": "^"},
    "predictor": _SHARE_LINE | {"color": "#12355b", "linestyle": "-", "marker": "o"},
    "board": _SHARE_LINE | {"color": "#a3a61a", "linestyle": (0, (3, 1, 1, 1, 1, 1)), "marker": "D"},
}

# Force over displacement.
FORCE: Look = {"linewidth": 2.4, "solid_capstyle": "butt", "zorder": 3}
POINTS: Look = {"color": "black", "linewidth": 1.6, "marker": "o", "markersize": 3.5, "zorder": 3}
FELT_ERROR = "plasma_r"
NOT_HELD: Look = {"color": "0.45", "linewidth": 1.4}
SNAP: Look = {"facecolor": "0.93", "linewidth": 0, "zorder": 0.4}
SNAP_ENERGY: Look = {"fontsize": 8, "rotation": 90, "ha": "center", "va": "top", "zorder": 4}
UNSTABLE_REGION: Look = {"facecolor": "none", "edgecolor": "0.5", "linewidth": 0, "hatch": "xxxx", "zorder": 0.6}
HYSTERESIS: Look = {"facecolor": "#d9e6f0", "edgecolor": "#7fa8c9", "linewidth": 0.6, "zorder": 1}

# Force over the plane.
FIELD: Look = {"angles": "xy", "scale_units": "xy", "scale": 1.15, "width": 0.0028, "pivot": "mid", "zorder": 3}
MATERIAL: Look = {"facecolor": "0.88", "edgecolor": "0.25", "linewidth": 1.2, "zorder": 1}
OUTLINES: dict[str, Look] = {
    "guide": {"color": "0.25", "linewidth": 1.4, "linestyle": (0, (5, 2)), "zorder": 2},
    "of other points": {"color": "0.55", "linewidth": 0.9, "zorder": 2},
    "travel": {"color": "0.45", "linewidth": 1.0, "linestyle": (0, (1, 2)), "zorder": 2},
}
PLACE: Look = {"marker": "o", "markersize": 5, "color": "black", "markeredgecolor": "white", "zorder": 5}
PLACE_NAME: Look = {
    "xytext": (5, 5),
    "textcoords": "offset points",
    "fontsize": 8.5,
    "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    "zorder": 6,
    "annotation_clip": True,
}

# Over time, and a device's residuals.
ZERO_LINE: Look = {"color": "black", "linewidth": 0.5}
MARK: Look = {"markersize": 5, "linestyle": "", "color": "black", "fillstyle": "none"}
ENVELOPE: Look = {"color": "black", "linewidth": 1.4, "linestyle": "--"}
MOTION: Look = {"color": "0.45", "linewidth": 1.2, "markersize": 3}
RESIDUAL: Look = {"color": "0.6", "marker": ".", "linestyle": "", "rasterized": True}
MEAN: Look = {"color": "tab:red", "marker": "o", "markersize": 4, "linewidth": 1.4}

# Table 1.
BAR: Look = {"height": 0.55, "facecolor": "0.85", "edgecolor": "0.4", "linewidth": 0.6}
MEASURED_BAR: Look = {"marker": "d", "linestyle": "", "color": "black", "markersize": 5}

# Speed against accuracy: hapsim's methods in colours, its peers in greys, each with a marker.
METHODS = (
    *("#1f3b73", "#d95f0e", "#1b8a5a", "#b0307c", "#e6a817"),
    *("#5aa7d6", "#7f4f24", "#c8252b", "#7b5fc0", "#93b83a", "#008080"),
)
METHOD: Look = {"marker": "o", "linewidth": 1.1, "markersize": 3.6, "markeredgewidth": 0.9, "zorder": 3.0}
PEER: Look = {"markerfacecolor": "white", "linewidth": 0.6, "markersize": 3.8, "markeredgewidth": 0.7, "zorder": 2.0}
PEERS = tuple(zip(("0.35", "0.50", "0.62", "0.42", "0.56", "0.68", "0.47", "0.60"), "v^<>PX*p", strict=True))
PRECISIONS: dict[str, Any] = {"double": "-", "single": (0, (3.0, 1.6))}
FRONT: Look = {"color": "#f6cf65", "linewidth": 4.5, "alpha": 0.75, "solid_joinstyle": "round", "zorder": 1.2}
REAL_TIME: Look = {"color": "0.2", "linewidth": 0.9, "linestyle": ":", "zorder": 1.0}

# Steadiness: rates by the colour map, so that print distinguishes them too; clocks by dashes.
RATES, LIGHTEST_RATE = "inferno", 0.82
CLOCKS: dict[str, Any] = {"": "-", "device": "-", "host": (0, (4, 1.5))}
