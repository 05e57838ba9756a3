"""Charts of a hand behind a belt or a lagging motor, beside its loop written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hapsim.chart.felt_chart import DesiredPlane, Outcome, drawn_for, felt_by
from hapsim.chart.hand import described, hands_of_scene
from hapsim.chart.plane_curves import Sheet, View, scale_of, stability_boundary
from hapsim.scene import parse_scene
from hapsim.units import LINEAR
from tests import driven_devices
from tests.driven_devices import Device, belted, radius

DEVICES = [
    belted(116.0, K=1000.0, B=4.0),
    belted(116.0, K=1000.0, B=4.0, reads_handle=True),
    Device(lag=5e-4, K=1000.0),
]


@pytest.mark.parametrize("device", DEVICES)
def test_curves_of_equal_k_and_the_limit_of_the_plane_are_those_of_the_loop(device: Device) -> None:
    (hand,) = hands_of_scene(parse_scene(device.yaml), {})
    c = hand.configuration
    assert hand.felt() == pytest.approx(driven_devices.felt(device), rel=1e-9)
    sheet = Sheet(c, View(2500.0, 0.0, 12.0), scale_of(c, normalised=False, total=False))
    curve = sheet.oscillators("iso_k", 900.0, np.full(40, 900.0), np.linspace(0.5, 9.0, 40))
    drawn = [point for point in zip(curve.K, curve.B, curve.k, curve.b, strict=True) if math.isfinite(point[0])]
    assert len(drawn) >= 10
    for K, B, k, b in drawn[::3]:
        assert driven_devices.felt(replace(device, K=K, B=B)) == pytest.approx((k, b), rel=1e-8)
    limit = stability_boundary(sheet)
    seen = np.flatnonzero(np.isfinite(limit.K))
    assert seen.size > 20
    for at in seen[:: max(1, seen.size // 9)]:
        assert radius(replace(device, K=float(limit.K[at]), B=float(limit.B[at]))) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("device", DEVICES[::2])
def test_the_felt_plane_has_the_corrections_that_a_drive_allows(device: Device) -> None:
    (hand,) = hands_of_scene(parse_scene(device.yaml), {})
    c, plane = hand.configuration, DesiredPlane.of_cells(8, 4)
    assert drawn_for(c) == ("none", "poles")
    poles, plain = (felt_by(name, c, c, plane) for name in ("poles", "none"))
    assert poles.share(0.01) > 0.3 > plain.share(0.01)
    k, b = plane.desired(c)
    at = tuple(np.argwhere(poles.outcome == Outcome.WITHIN_1)[-1])
    K, B = c.simulated(k[at], b[at])
    assert driven_devices.felt(replace(device, K=float(K), B=float(B))) == pytest.approx((k[at], b[at]), rel=1e-8)


def test_a_title_names_belt_and_lag_in_a_line_of_their_own() -> None:
    titles = [described(hands_of_scene(parse_scene(one.yaml), {})[0].configuration, units=LINEAR) for one in DEVICES]
    lines = [one.split("\n")[1] for one in titles]
    assert lines[1].startswith("motor of 0.05 kg on a belt of ")
    assert lines[1].endswith("handle sensed")
    assert lines[2] == "motor lag 0.5 ms"
