"""Sweeps of a scene in the plane, and at a place: the numbers of `predict` and `measure` there."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hapsim as package
from hapsim.errors import UsageError
from hapsim.scene.shipped import shipped_scene
from hapsim.scene.varied import Varied

AXES = {"disc.stiffness": [500.0, 2000.0], "device.delay": [1.0]}
ASIDE = (0.0213, 0.0167)  # m: pressed by about 1 mm, in a direction that is none of x and y
DURATION = 2.0


def test_a_place_in_the_plane_is_predicted_and_measured_along_both_directions() -> None:
    found = package.sweep("disc", AXES, at=ASIDE, duration=DURATION)
    assert not found["error"].values.any()
    for stiffness in AXES["disc.stiffness"]:
        for delay in AXES["device.delay"]:
            values = {"disc.stiffness": stiffness, "device.delay": delay}
            point, scene = found.sel(values), Varied(package.load_scene("disc")).scene(values)
            prediction: Any = package.predict(scene, at=ASIDE)
            assert (point["stable"], point["spectral_radius"]) == (prediction.stable, prediction.spectral_radius)
            for rank, one in enumerate(prediction.parts[0].along("hand"), 1):
                assert point[f"predicted_k_{rank}"] == one.k
                assert point[f"predicted_b_{rank}"] == one.b
                assert point[f"predicted_angle_{rank}"] == one.angle_deg
                assert point[f"measured_k_{rank}"] == pytest.approx(one.k, rel=1e-4)
                assert point[f"measured_b_{rank}"] == pytest.approx(one.b, rel=1e-4)
                assert point[f"measured_angle_{rank}"] == pytest.approx(one.angle_deg, abs=0.02)  # friction left
    assert (found["predicted_k_1"] > found["predicted_k_2"]).all()


def test_uncertainties_are_those_of_the_matrices_turned_into_the_direction() -> None:
    found = package.sweep("disc", {"device.delay": [1.0]}, at=ASIDE, duration=DURATION, quantities=("measured",))
    measured = package.measure(package.load_scene("disc"), at=ASIDE, duration=DURATION)
    for rank in (1, 2):
        angle = math.radians(found[f"measured_angle_{rank}"].item())
        n = np.array([math.cos(angle), math.sin(angle)])
        for name, unsure in (("k", measured.k_uncertainty), ("b", measured.b_uncertainty)):
            expected = math.sqrt(sum((n[i] * n[j] * unsure[i, j]) ** 2 for i in (0, 1) for j in (0, 1)))
            assert found[f"measured_{name}_{rank}_uncertainty"].item() == pytest.approx(expected, rel=1e-9)
    assert found["measured_angle_1"].attrs["units"] == "°"


def test_a_measured_angle_is_that_of_the_predicted_line() -> None:
    found = package.sweep("disc", {"device.delay": [0.0, 0.5, 1.0]}, at=(0.011, 0.0), duration=DURATION)
    assert (found["predicted_angle_1"] == 0.0).all()
    assert (abs(found["measured_angle_1"]) < 0.01).all()  # not 179.9999


def test_a_scene_in_the_plane_is_not_called_passive_and_a_sliding_hand_is_not_stable() -> None:
    found = package.sweep("disc", {"disc.friction_coefficient": [0.0, 0.3]}, at=(0.011, 0.0), quantities=("predicted",))
    assert not {"passive", "needed_friction", "contact_states", "unstable_states"} & {*found}
    assert found["stable"].values.tolist() == [0.0, 1.0]
    assert (found["spectral_radius"].values > 1.0).tolist() == [True, False]
    assert (found["predicted_k_2"].values > 0.0).tolist() == [False, True]


def test_without_a_place_the_hand_is_where_it_starts() -> None:
    found = package.sweep("disc", {"device.delay": [0.0, 1.0]}, duration=DURATION)
    assert (found["predicted_k_1"] == 0.0).all()
    assert np.isnan(found["measured_k_1"]).all()
    assert all("no link touches the hand" in one for one in found["error"].values)


def test_on_a_line_a_place_is_that_of_predict_and_measure() -> None:
    at = -0.0045  # m, below the snap
    one = package.parse_scene(shipped_scene("button.yaml"))
    one = one.model_copy(update={"device": one.device.model_copy(update={"clock": "lockstep"})})
    found = package.sweep(one, {"device.delay": [1.0]}, at=at, duration=0.5)
    assert found["predicted_k"].item() == package.predict(one, at=at).felt[0].k
    assert found["predicted_k"].item() != package.predict(one).felt[0].k
    assert found["measured_k"].item() == pytest.approx(found["predicted_k"].item(), rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": 0.011}, r"expected x, y in a scene with space: 2"),
        ({"at": (0.011, 0.0), "quantities": ("impedance",)}, "measured where the hand is"),
        ({"at": (0.2, 0.0)}, "outside the travel of hand"),
    ],
)
def test_a_place_that_fits_no_point_is_refused_at_once(options: dict[str, Any], message: str) -> None:
    text = shipped_scene("disc.yaml").replace("  force_limit:", "  travel: {disc: 0.05}\n  force_limit:")
    with pytest.raises(UsageError, match=message):
        package.sweep(package.parse_scene(text), {"device.delay": [0.0, 1.0]}, **options)


def test_another_place_is_another_sweep(tmp_path: Path) -> None:
    out, axes = tmp_path / "out.nc", {"device.delay": [0.0, 1.0]}

    def stop(_done: int, _every: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        package.sweep("disc", axes, at=(0.011, 0.0), out=out, quantities=("predicted",), on_progress=stop)
    with pytest.raises(UsageError, match="another sweep, which differs in: at"):
        package.sweep("disc", axes, at=(0.0115, 0.0), out=out, quantities=("predicted",))
    package.sweep("disc", axes, at=(0.011, 0.0), out=out, quantities=("predicted",))
    with pytest.raises(UsageError, match="it exists"):
        package.sweep("disc", axes, at=(0.0115, 0.0), out=out, quantities=("predicted",))


def test_the_command_takes_a_place_prints_both_directions_and_draws(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    out, data = tmp_path / "out.nc", tmp_path / "out.csv"
    words = ("disc.stiffness=500,2000", "--at", "11mm,0", "--duration", "2", "--out", out, "--data", data)
    found = hapsim("sweep", "disc", *words, "--json").document
    assert {*found["measured_off_predicted"]} == {"k_1", "b_1", "k_2", "b_2"}
    assert found["variables"]["predicted_angle_2"]["least"] == pytest.approx(90.0)
    assert data.read_text(encoding="utf-8").startswith("disc.stiffness,predicted_k_1")
    with xarray.open_dataset(out, engine="h5netcdf") as opened:
        assert opened.attrs["at"] == "[0.011, 0.0]"
