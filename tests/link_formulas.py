"""Second implementation of each link's tension, from d and its growth in a sample, both in m, numbers or (except
friction) arrays. It is a reference for the kernel and the theory, which read the knots that each link's class makes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Tension = Callable[[Any, Any], Any]


def tension_of(link: Any, rate: float, sensed: Callable[[], float] = lambda: 0.0) -> Tension:
    """Returns a link's tension at `rate` Hz; `sensed`: the growth measured by the sensor beyond that of d, m."""
    if link.type == "viscoelastic":
        return viscoelastic(link, rate, sensed)
    if link.type == "spring":
        return lambda d, _growth: link.stiffness * d
    if link.type == "damper":
        return lambda _d, growth: link.damping * rate * growth
    if link.type == "buffer":
        pushed = lambda d, growth: link.stiffness * (d - link.distance) + link.damping * rate * growth  # noqa: E731
        return lambda d, growth: np.where(d < link.distance, np.minimum(0.0, pushed(d, growth)), 0.0)
    if link.type == "nonlinear" and link.branches:
        return branches(link.branches)
    if link.type == "nonlinear":
        curves = [curve and np.array(curve).T for curve in (link.force_over_distance, link.force_over_velocity)]
        return lambda d, growth: sum(
            np.interp(x, *curve) for curve, x in zip(curves, (d, rate * growth), strict=True) if curve is not None
        )
    if link.type == "detent" and link.is_held:
        return held_detent(link, rate)
    if link.type == "detent":
        width = link.pitch / link.steepness if link.shape == "notch" else link.pitch
        peak_at = width / 4.0 if link.shape == "notch" else 0.5 * width * link.steepness / (link.steepness + 1.0)

        def detent(d: Any, growth: Any) -> Any:
            u = d - link.pitch * np.round(d / link.pitch)
            straight = np.sign(u) * np.interp(abs(u), [0.0, peak_at, width / 2.0], [0.0, 1.0, 0.0])
            part = np.sin(2.0 * np.pi * d / link.pitch) if link.shape == "sine" else straight
            return link.depth * part + link.damping * rate * growth

        return detent
    if link.type == "click":
        at = np.array([0.0, link.peak_at, 0.5 * (1.0 + link.peak_at), 1.0, 1001.0]) * link.travel
        push = link.peak - np.array([link.peak, 0.0, link.drop, link.drop - 0.5 * link.peak, 0.0])
        push[4] = push[3] + 1000.0 * link.bottom * link.travel
        most = max(0.0, link.drop - link.peak)  # it stays down
        pulled = lambda d, growth: np.minimum(most, link.damping * rate * growth - np.interp(-d, at, push))  # noqa: E731
        return lambda d, growth: np.where(d < 0.0, pulled(d, growth), 0.0)
    return (friction if link.type == "friction" else plectrum)(link, rate)


def viscoelastic(link: Any, rate: float, sensed: Callable[[], float]) -> Tension:
    memory: dict[str, float] = {}
    kept = np.exp(-2.0 * np.pi * link.cutoff / rate) if link.cutoff else 0.0

    def tension(d: Any, growth: Any) -> Any:
        if link.damper == "centred":
            older = memory.get("d", d - 2.0 * growth)
            memory["d"] = d - growth
            growth = 0.5 * (d - older)
        elif link.damper == "filtered":
            growth = memory["growth"] = growth + kept * (memory.get("growth", growth) - growth)
        elif link.damper == "sensed":
            growth += sensed()
        return link.stiffness * d + link.damping * rate * growth

    tension.memory = memory  # type: ignore[attr-defined]
    return tension


def friction(link: Any, rate: float) -> Tension:
    memory: dict[str, float] = {"way": 0.0}

    def tension(d: float, growth: float) -> float:
        anchor = memory.setdefault("anchor", d)
        if memory["way"] * growth < 0.0:
            memory["way"] = 0.0
        bent = link.stiffness * (d - anchor)
        if memory["way"] == 0.0 and abs(bent) > link.break_away:
            memory["way"] = np.sign(bent)
        if memory["way"]:
            memory["anchor"] = d - memory["way"] * link.force / link.stiffness
            return float(memory["way"] * link.force)
        return float(bent + link.damping * rate * growth)

    tension.memory = memory  # type: ignore[attr-defined]
    return tension


def branches(curve: Any) -> Tension:
    """Goes from z to z, between -1 and 1."""
    memory: dict[str, float] = {}
    (x, press), (_, release) = np.array(curve.press).T, np.array(curve.release).T

    def tension(d: float, _growth: float) -> float:
        z = memory.get("z", 0.0) + 2.0 * (d - memory.get("d", d)) / curve.width
        z = memory["z"] = min(max(z, -1.0), 1.0)
        memory["d"] = d
        pressing, releasing = float(np.interp(d, x, press)), float(np.interp(d, x, release))
        return 0.5 * (1.0 + z) * pressing + 0.5 * (1.0 - z) * releasing

    tension.memory = memory  # type: ignore[attr-defined]
    return tension


def held_detent(link: Any, rate: float) -> Tension:
    """Moves by whole places: it asks the neighbours, the one above first, until none takes over."""
    memory: dict[str, int] = {}
    places, hold, free = link.places, link.hold_until or 0.5, link.dead_zone or 0.0

    def rest(k: int) -> float:
        return float(places[k]) if places else k * link.pitch

    def exists(k: int) -> bool:
        return not places or 0 <= k < len(places)

    def flank(k: int, other: int) -> float:
        if not exists(other):
            back = 2 * k - other
            return float(link.stop) if link.stop is not None else flank(k, back)
        return float(link.depth / (hold * abs(rest(other) - rest(k)) - free))

    def tension(d: float, growth: float) -> float:
        if "place" not in memory:
            near = range(len(places)) if places else range(round(d / link.pitch) - 1, round(d / link.pitch) + 2)
            memory["place"] = min(near, key=lambda k: abs(d - rest(k)))
        k = memory["place"]
        for step in (1, -1):
            while exists(k + step) and step * (d - rest(k)) > hold * abs(rest(k + step) - rest(k)):
                k += step
        memory["place"] = k
        u = d - rest(k)
        bent = float(np.sign(u)) * max(abs(u) - free, 0.0)
        other = k + (1 if u > 0.0 else -1)
        is_silent = link.only is not None and k not in link.only and exists(other)
        stiffness = 0.0 if is_silent or bent == 0.0 else flank(k, other)
        return stiffness * bent + link.damping * rate * growth

    tension.memory = memory  # type: ignore[attr-defined]
    return tension


def plectrum(link: Any, rate: float) -> Tension:
    memory: dict[str, Any] = {"side": 0.0}

    def tension(d: Any, growth: Any) -> Any:
        stays, side = memory["side"] * d > 0.0, np.where(np.abs(d) > link.release, np.sign(d), 0.0)
        memory["side"] = np.where(stays, memory["side"], side)
        return np.where(memory["side"] == 0.0, link.stiffness * d + link.damping * rate * growth, 0.0)

    tension.memory = memory  # type: ignore[attr-defined]
    return tension
