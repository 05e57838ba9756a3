"""Numbers on curves: each where it covers nothing else, along its curve."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart import plane_looks as looks
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FRACTIONS = (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74, 0.18, 0.82, 0.12, 0.88)
_AIR = 2.0  # pixels around a text
_DOT = 10.0  # pixels from the middle of an operating point
_SPACING = 3.0  # pixels between the points of a line
_LENGTHS = 1.8  # a curve shorter than so many texts bears none

Box = tuple[float, float, float, float]


class Labels:
    """Texts on one picture, which keep clear of each other and, where they can, of the other lines.

    The layout has to be settled and every line drawn before the first text is set.
    """

    def __init__(self, axes: Axes, lines: list[tuple[Floats, Floats]]) -> None:
        self._axes = axes
        self._renderer: Any = axes.get_figure(root=True).canvas.get_renderer()  # type: ignore[union-attr]
        self._taken: list[Box] = []
        self._ink = np.concatenate([self._pixels(*line) for line in lines] or [np.empty((0, 2))])
        self._frame = axes.get_window_extent(self._renderer)

    def along(self, x: Floats, y: Floats, words: str, **style: Any) -> bool:
        """Writes on a line, at a gap in it; whether there was a place."""
        piece = self._longest_piece(self._pixels(x, y, gaps=True))
        if piece.shape[0] < 4:
            return False
        text = self._axes.text(0, 0, words, ha="center", va="center", rotation_mode="anchor", zorder=5, **style)
        text.set_bbox(looks.NUMBER_BOX)
        width = text.get_window_extent(self._renderer).width
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(piece, axis=0).T))])
        best: tuple[float, Any, float, Box] | None = None
        for number, fraction in enumerate(_FRACTIONS):
            if length[-1] < _LENGTHS * width:
                break
            found = self._at(text, piece, length, fraction * length[-1], 0.6 * width)
            if found is not None:
                place, angle, box, covered = found
                cost = covered + 0.7 * number
                if best is None or cost < best[0]:
                    best = cost, place, angle, box
        if best is None:
            text.remove()
            return False
        _, place, angle, box = best
        text.set_position(tuple(self._axes.transData.inverted().transform(place)))
        text.set_rotation(angle)
        self._taken.append(box)
        return True

    def beside(self, x: float, y: float, words: str, **style: Any) -> None:
        """Writes beside a point, on the side where it covers least, with a thin line to the point."""
        from matplotlib.text import Text

        best = None
        for distance in (22.0, 40.0, 62.0):
            for right, up in ((1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (0, 1), (0, -1), (-1, 0)):
                text = self._axes.annotate(
                    words,
                    (x, y),
                    (right * distance, up * distance * 0.7),
                    textcoords="offset points",
                    ha={1: "left", 0: "center", -1: "right"}[right],
                    va={1: "bottom", 0: "center", -1: "top"}[up],
                    arrowprops={"arrowstyle": "-", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3},
                    zorder=7,
                    multialignment="left",
                    **style,
                )
                text.set_bbox(looks.WORDS_BOX)
                text.update_positions(self._renderer)
                extent = Text.get_window_extent(text, self._renderer)  # without the line to the point
                box = (extent.x0 - 6, extent.y0 - 6, extent.x1 + 6, extent.y1 + 6)
                cost = self._covered(box) + distance + (0.0 if self._is_free(box) else 1e6)
                if best is None or cost < best[0]:
                    if best is not None:
                        best[1].remove()
                    best = cost, text, box
                else:
                    text.remove()
        assert best is not None
        dot = self._pixels(np.array([x]), np.array([y]))[0]
        self._taken += [best[2], (dot[0] - _DOT, dot[1] - _DOT, dot[0] + _DOT, dot[1] + _DOT)]

    def _at(
        self, text: Any, piece: Floats, length: Floats, where: float, half: float
    ) -> tuple[Floats, float, Box, float] | None:
        """(place, angle, box, what it covers) of a text on a line; None where it would touch another or leave."""
        place, before, after = (
            np.array([np.interp(at, length, piece[:, i]) for i in (0, 1)]) for at in (where, where - half, where + half)
        )
        if where - half < 0.0 or where + half > length[-1]:
            return None
        along = after - before
        # Where the line bends much, a straight text does not lie on it.
        if np.hypot(*along) < 1.7 * half:
            return None
        angle = (np.degrees(np.arctan2(along[1], along[0])) + 90.0) % 180.0 - 90.0
        text.set_position(tuple(self._axes.transData.inverted().transform(place)))
        text.set_rotation(angle)
        extent = text.get_window_extent(self._renderer)
        box = (extent.x0 - _AIR, extent.y0 - _AIR, extent.x1 + _AIR, extent.y1 + _AIR)
        return (place, float(angle), box, self._covered(box)) if self._is_free(box) else None

    def _is_free(self, box: Box) -> bool:
        frame = self._frame
        inside = box[0] > frame.x0 and box[1] > frame.y0 and box[2] < frame.x1 and box[3] < frame.y1
        return inside and not any(
            box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3] for other in self._taken
        )

    def _covered(self, box: Box) -> float:
        x, y = self._ink.T
        return float(np.count_nonzero((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])))

    def _pixels(self, x: Floats, y: Floats, *, gaps: bool = False) -> Floats:
        """(n, 2): a line in pixels, a point every few of them; gaps kept as NaN or left out."""
        points = self._axes.transData.transform(np.column_stack([x, y]))
        step = np.hypot(*np.diff(points, axis=0).T)
        count = np.where(np.isfinite(step), np.maximum(np.ceil(step / _SPACING), 1.0), 1.0).astype(int)
        start = np.repeat(np.arange(count.size), count)
        share = (np.arange(start.size) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
        between = points[:-1][start] + share[:, None] * np.nan_to_num(np.diff(points, axis=0)[start])
        points = np.concatenate([between, points[-1:]])
        return points if gaps else points[np.all(np.isfinite(points), axis=1)]

    def _longest_piece(self, points: Floats) -> Floats:
        """The longest part of a line inside the frame that no gap breaks."""
        x, y = points.T
        frame = self._frame
        with np.errstate(invalid="ignore"):
            good = (x > frame.x0) & (x < frame.x1) & (y > frame.y0) & (y < frame.y1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
        pieces = [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return max(pieces, key=lambda piece: float(np.sum(np.hypot(*np.diff(piece, axis=0).T))), default=points[:0])
