"""Results of a sweep: equal to those of single commands, to the bit, however and wherever they are worked out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hapsim
from hapsim.errors import UsageError
from hapsim.scene import Scene
from hapsim.scene.varied import Varied
from hapsim.sweeping import sweep as room
from hapsim.sweeping.parts import Parts
from hapsim.sweeping.sweep import write

SCENE = "first_touch"
AXES = {"touch.stiffness": [300.0, 2000.0, 5000.0], "device.delay": [0.0, 0.37, 1.0]}
DURATION = 0.5


def in_lockstep(values: dict[str, Any]) -> Scene:
    scene = hapsim.load_scene(SCENE)
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
    return Varied(scene).scene(values)


def test_each_point_is_what_predict_and_measure_report_of_its_scene(tmp_path: Path) -> None:
    out = tmp_path / "one.nc"
    found = hapsim.sweep(SCENE, AXES, duration=DURATION, out=out)
    with xarray.open_dataset(out, engine="h5netcdf") as again:
        assert again.load().drop_attrs().equals(found.drop_attrs())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.nc"]
    assert found.sizes == {"touch.stiffness": 3, "device.delay": 3}
    assert not found["error"].values.any()
    for stiffness in AXES["touch.stiffness"]:
        for delay in AXES["device.delay"]:
            one = found.sel({"touch.stiffness": stiffness, "device.delay": delay})
            of_point = in_lockstep({"touch.stiffness": stiffness, "device.delay": delay})
            prediction, measured = hapsim.predict(of_point), hapsim.measure(of_point, duration=DURATION)
            assert one["predicted_k"] == prediction.felt[0].k
            assert one["predicted_b"] == prediction.felt[0].b
            assert one["stable"] == prediction.stable
            assert one["spectral_radius"] == prediction.spectral_radius
            assert one["measured_k"] == measured.k
            assert one["measured_b_uncertainty"] == measured.b_uncertainty
    assert found["measured_k"].attrs == {"units": "N/m", "description": "measured stiffness that the hand feels"}


def double_stiffness(scene: Scene) -> dict[str, float]:
    """A function for a sweep."""
    if scene.device.delay > 0.9:
        raise UsageError("too late")
    if scene.device.delay > 0.3:
        raise ZeroDivisionError("of a user's own")
    return {"doubled": 2.0 * scene.modules["touch"].stiffness}  # type: ignore[union-attr]


def test_a_function_adds_its_numbers_and_its_failures_are_sentences() -> None:
    found = hapsim.sweep(SCENE, AXES, quantities=(), function=double_stiffness)
    assert found["doubled"].values[:, 0].tolist() == [600.0, 4000.0, 10000.0]
    assert np.isnan(found["doubled"].values[:, 1:]).all()
    assert found["error"].values[:, 2].tolist() == ["function: too late"] * 3
    assert found["error"].values[:, 1].tolist() == ["function: ZeroDivisionError: of a user's own"] * 3
    assert not found["error"].values[:, 0].any()


def test_impedances_have_a_dimension_of_frequency() -> None:
    found = hapsim.sweep(SCENE, {"touch.stiffness": [500.0, 1000.0]}, quantities=("impedance",), duration=4.0)
    assert found["measured_impedance_re"].dims == ("touch.stiffness", "frequency_hz")
    for part in ("re", "im"):
        predicted, measured = (found[f"{how}_impedance_{part}"] for how in ("predicted", "measured"))
        assert float(abs(measured - predicted).max()) < 2e-3 * float(abs(predicted).max())
    with pytest.raises(UsageError, match="sweep each rate by itself"):
        hapsim.sweep(SCENE, {"rate": [1000.0, 2000.0]}, quantities=("impedance",))


def test_a_point_that_fails_has_its_reason_and_the_others_their_numbers() -> None:
    axes = {"touch.stiffness": [500.0, 1e9], "mock.quantum": [1e-9, 10.0]}
    found = hapsim.sweep(SCENE, axes, duration=DURATION)
    errors = found["error"].values
    assert errors[0, 0] == ""
    assert found["measured_k"].values[0, 0] == pytest.approx(found["predicted_k"].values[0, 0], rel=1e-6)
    assert errors[0, 1].startswith("measured: ")  # a count of ten metres shows no motion
    assert np.isnan(found["measured_k"].values[0, 1])
    assert np.isfinite(found["predicted_k"].values[0, 1])
    assert found["stable"].values[1, 0] == 0.0
    with pytest.raises(UsageError, match=r"touch\.stiffness: found -1, expected a number >= 0"):
        hapsim.sweep(SCENE, axes | {"touch.stiffness": [-1.0, 500.0]}, duration=DURATION)


def test_a_zarr_has_the_same(tmp_path: Path) -> None:
    found = hapsim.sweep(SCENE, {"touch.stiffness": [500.0, 900.0]}, quantities=("predicted",), out=tmp_path / "a.zarr")
    again = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False).load()
    assert again.drop_attrs().equals(found.drop_attrs())


def test_a_sweep_goes_on_with_what_is_missing_and_repeats_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axes, out = {"touch.stiffness": np.linspace(100, 5000, 16)}, tmp_path / "a.nc"
    whole = hapsim.sweep(SCENE, axes, duration=DURATION)
    done = 0

    def stop_after(most: int) -> Any:
        def progress(now: int, _every: int) -> None:
            nonlocal done
            done = now
            if now >= most:
                raise KeyboardInterrupt

        return progress

    for most in (5, 9):
        with pytest.raises(KeyboardInterrupt):
            hapsim.sweep(SCENE, axes, duration=DURATION, out=out, on_progress=stop_after(most))
        assert not out.exists()
    before, worked = done, []
    true_work = room.work

    def count(task: Any, points: Any) -> Any:
        worked.extend(points)
        return true_work(task, points)

    monkeypatch.setattr(room, "work", count)
    assert hapsim.sweep(SCENE, axes, duration=DURATION, out=out).identical(whole)
    assert 16 - before <= len(worked) <= 16 - before + 3  # three are worked out once more, to find how long one takes


def test_another_sweep_s_results_and_finished_ones_are_left_alone(tmp_path: Path) -> None:
    out, axes = tmp_path / "a.nc", {"touch.stiffness": [100.0, 200.0]}

    def interrupt(done: int, _every: int) -> None:
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hapsim.sweep(SCENE, axes, quantities=("predicted",), out=out, on_progress=interrupt)
    with pytest.raises(UsageError, match=r"a\.nc\.parts: .* another sweep, which differs in: points"):
        hapsim.sweep(SCENE, {"touch.stiffness": [100.0, 300.0]}, quantities=("predicted",), out=out)
    with pytest.raises(UsageError, match="differs in: quantities, duration"):
        hapsim.sweep(SCENE, axes, out=out, duration=DURATION)
    part = next((tmp_path / "a.nc.parts").glob("*.npz"))
    kept = part.read_bytes()
    part.write_bytes(kept[: len(kept) // 2])
    with pytest.raises(UsageError, match="damaged"):
        hapsim.sweep(SCENE, axes, quantities=("predicted",), out=out)
    part.write_bytes(kept)
    hapsim.sweep(SCENE, axes, quantities=("predicted",), out=out)
    whole = out.read_bytes()
    for others in (axes | {"touch.stiffness": [100.0, 300.0]}, axes | {"touch.damping": [1.0]}):
        with pytest.raises(UsageError, match="it exists"):
            hapsim.sweep(SCENE, others, quantities=("predicted",), out=out)
    with pytest.raises(UsageError, match="it exists"):
        hapsim.sweep(SCENE, axes, quantities=("measured",), out=out)
    with xarray.open_dataset(out, engine="h5netcdf") as found:
        assert hapsim.sweep(SCENE, axes, quantities=("predicted",), out=out).identical(found.load())  # read again
    assert out.read_bytes() == whole


def test_a_point_that_feels_like_no_spring_reports_why() -> None:
    axes = {"touch.stiffness": [1.0, 200.0], "touch.damping": [0.5, 0.1]}
    found = hapsim.sweep("paper_6_3_real_damping", axes, duration=DURATION)
    has_none = np.isnan(found["predicted_k"].values)
    assert has_none.tolist() == [[True, False], [True, False]]
    assert [["predicted: " in one for one in row] for row in found["error"].values] == has_none.tolist()
    assert [["measured: " in one for one in row] for row in found["error"].values] == has_none.tolist()


def test_attributes_name_what_was_swept() -> None:
    found = hapsim.sweep(SCENE, {"touch.stiffness": [500.0]}, quantities=("predicted",))
    assert json.loads(found.attrs["scene"])["modules"]["touch"]["damping"] == 5.0
    assert json.loads(found.attrs["versions"]).keys() >= {"hapsim", "numpy", "processor"}


def test_workers_wait_for_one_another_at_a_lock_that_follows_no_link(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HAPSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(room, "work", lambda *_: None)
    room.ready(None, None)  # type: ignore[arg-type]
    assert (tmp_path / "cache" / "sweep.lock").stat().st_mode & 0o777 == 0o600
    victim, lock = tmp_path / "victim", tmp_path / "cache" / "sweep.lock"
    victim.write_text("mine")
    lock.unlink()
    lock.symlink_to(victim)
    room.ready(None, None)  # type: ignore[arg-type]
    assert victim.read_text() == "mine"


def test_the_lock_of_a_sweep_follows_no_link(tmp_path: Path) -> None:
    (tmp_path / "s.nc.parts").mkdir()
    (tmp_path / "s.nc.parts" / "lock").symlink_to(tmp_path / "victim")
    with pytest.raises(UsageError, match="cannot be written"):
        Parts(tmp_path / "s.nc", {})
    assert not (tmp_path / "victim").exists()


def test_a_sweep_is_written_at_no_name_that_a_link_can_be_planted_at(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    names: list[str] = []
    monkeypatch.setattr(Path, "replace", lambda one, _: names.append(one.name))
    (tmp_path / "s.nc.parts").mkdir()
    for _ in range(2):
        write(xarray.Dataset({"k": ("point", [1.0])}), tmp_path / "s.nc")
    assert len(set(names)) == 2
