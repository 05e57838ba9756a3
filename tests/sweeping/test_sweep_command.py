"""`hapsim sweep`: killed and resumed, on a cluster, with pictures; what it refuses."""

from __future__ import annotations

import random
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import hapsim as package
from hapsim.number_format import share_in_percent
from tests import thorough

SCENE = "first_touch"
KILLS = thorough.points(1, 1)  # HAPSIM_POINTS=10 in half a minute
WORDS = ("touch.stiffness=log:100:4000:8", "device.delay=0,1", "mock.noise=0,1e-6", "--duration", "0.5")


def results(file: Path) -> xarray.Dataset:
    with xarray.open_dataset(file, engine="h5netcdf") as opened:
        return opened.load()


def test_a_sweep_of_two_processes_that_is_killed_and_started_again_equals_that_of_one(
    start_hapsim: Callable[..., Any], hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    """To the bit, also with random noise."""
    whole, out, choose = tmp_path / "whole.nc", tmp_path / "out.nc", random.Random(7)
    assert hapsim("sweep", SCENE, *WORDS, "--out", whole, "--jobs", 1).status == 0
    parts, kept = tmp_path / "out.nc.parts", 0
    for _ in range(KILLS):
        killed = start_hapsim("sweep", SCENE, *WORDS, "--out", out, "--jobs", 2)
        give_up = time.monotonic() + 60
        while len(list(parts.glob("*.npz"))) <= kept and killed.poll() is None and time.monotonic() < give_up:
            time.sleep(0.01)
        time.sleep(choose.uniform(0.0, 0.2))
        killed.kill()
        kept = len(list(parts.glob("*.npz")))
    last = hapsim("sweep", SCENE, *WORDS, "--out", out, "--jobs", 1)
    assert last.status == 0, last.err
    assert results(out).identical(results(whole))
    assert not parts.exists()


@contextmanager
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed: hapsim[dask]")
    import dask

    with (
        dask.config.set({"distributed.worker.profile.enabled": False, "distributed.admin.tick.limit": "60s"}),
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1", silence_logs=50
        ) as found,
    ):
        yield found


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")  # of dask, of its event loop and of what it imports
def test_a_worker_of_a_cluster_that_is_killed_and_joins_again_finds_the_same() -> None:
    axes = {"touch.stiffness": np.geomspace(100, 4000, 15), "device.delay": [0.0, 0.5, 1.0]}
    here = package.sweep(SCENE, axes, duration=0.5)
    with cluster() as found:
        killed: list[Any] = []

        def disturb(done: int, every: int) -> None:
            if not killed and every > done > 10:
                killed.append(found.workers[0].process.process)
                killed[0].kill()

        there = package.sweep(SCENE, axes, duration=0.5, scheduler=found.scheduler_address, on_progress=disturb)
    assert killed
    assert there.identical(here)


def test_the_command_writes_a_dataset_a_picture_and_what_it_found(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    out, picture, data = tmp_path / "a.nc", tmp_path / "a.png", tmp_path / "a.csv"
    words = ("sweep", SCENE, "touch.stiffness=500,1000,2000", "device.delay=0,1", "--duration", 0.5, "--out", out)
    answer = hapsim(*words, "--picture", picture, "--data", data, "--draw", "predicted_b", "--json")
    assert answer.status == 0, answer.err
    assert answer.document["dimensions"] == {"touch.stiffness": 3, "device.delay": 2}
    assert answer.document["failed"] == 0
    assert answer.document["variables"]["measured_k"]["unit"] == "N/m"
    assert answer.document["measured_off_predicted"]["k"]["most"] < 1e-6
    assert picture.read_bytes().startswith(b"\x89PNG")
    heading, *rows = data.read_text("utf-8").splitlines()
    assert heading == "touch.stiffness,device.delay,predicted_b"
    assert len(rows) == 6
    expected = float(results(out)["predicted_b"].sel({"touch.stiffness": 500.0, "device.delay": 1.0}))
    assert f"500.0,1.0,{expected!r}" in rows


def test_no_stiffness_is_no_share_of_one(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    words = ("touch.stiffness=0", "touch.damping=5", "--duration", 0.5, "--out", tmp_path / "a.nc", "--json")
    answer = hapsim("sweep", SCENE, *words)
    assert answer.document["measured_off_predicted"].keys() == {"b"}
    assert abs(answer.document["variables"]["measured_k"]["most"]) < 1e-3


def test_samples_and_tables_are_drawn_and_printed_for_people(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("touch.stiffness,device.delay\n500,0\n-3,1\n-3,1\n", encoding="utf-8")
    table = ("--points", tmp_path / "points.csv", "--out", tmp_path / "a.nc", "--picture", tmp_path / "a.svg")
    answer = hapsim("sweep", SCENE, *table, "--check")
    assert answer.status == 0
    assert "2 points failed" in answer.out + answer.err
    assert (answer.out + answer.err).count("found -3") == 1  # an equal reason once
    assert "found -3" in answer.out + answer.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("touch.stifness=1,2",), "did you mean 'touch.stiffness'"),
        (("touch.stiffness=1,2", "--out", "x.txt"), "expected .nc or .zarr"),
        (("touch.stiffness=1,2", "--channel", "3"), "channel 3"),
        (("--points", "missing.csv"), "missing.csv: cannot be read"),
        (("touch.stiffness=1,2", "--picture", "x.bmp"), "x.bmp"),
        (("touch.stiffness=1,2", "--picture", "x.svg", "--over", "rate"), "expected touch.stiffness"),
        (
            ("touch.stiffness=1,2", "--check", "--picture", "x.svg", "--draw", "predicted_q"),
            "did you mean 'predicted_k'",
        ),
        ((), "no parameter"),
    ],
)
def test_what_cannot_be_swept_is_answered_with_a_sentence(
    hapsim: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    out = () if "--out" in words else ("--out", "a.nc")
    answer = hapsim("sweep", SCENE, *words, *out)
    assert answer.status == 2
    assert said in answer.sentence
    assert not list(tmp_path.glob("*.nc*"))


@pytest.mark.filterwarnings("ignore")
def test_an_unreachable_scheduler_is_named(
    hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed: hapsim[dask]")
    monkeypatch.setattr("hapsim.sweeping.sweep._REACHED_S", 0.5)
    words = ("touch.stiffness=lin:100:200:8", "--check", "--scheduler", "tcp://127.0.0.1:9", "--out", tmp_path / "a.nc")
    answer = hapsim("sweep", SCENE, *words)
    assert answer.status == 2
    assert "tcp://127.0.0.1:9: cannot be reached" in answer.sentence
    assert list((tmp_path / "a.nc.parts").glob("*.npz"))  # what was found until then


def test_what_is_not_installed_is_named(
    hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    answer = hapsim("sweep", SCENE, "touch.stiffness=1,2", "--out", tmp_path / "a.nc")
    assert answer.status == 2
    assert "install hapsim[sweep]" in answer.sentence


def test_a_bad_value_is_refused_before_anything_is_worked_out(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    answer = hapsim("sweep", SCENE, "touch.stiffness=100,abc", "--out", tmp_path / "a.nc")
    assert (answer.status, answer.out) == (2, "")
    assert "swept" not in answer.err
    assert "touch.stiffness: found 'abc', expected a number >= 0 (N/m)" in answer.sentence


def test_progress_in_a_pipe_ends_with_all_points(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    answer = hapsim("sweep", SCENE, "touch.stiffness=500,1000", "--check", "--out", tmp_path / "a.nc")
    assert answer.err.splitlines()[-1] == "finished 2 points"


def test_what_is_stable_or_passive_is_counted_and_drawn_as_a_share(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    words = ("touch.stiffness=100,1000,90000", "device.delay=0,1", "touch.damping=0,5", "--check", "--draw", "stable")
    files = ("--out", tmp_path / "a.nc", "--data", tmp_path / "a.csv", "--picture", tmp_path / "a.svg")
    answer = hapsim("sweep", SCENE, *words, *files)
    stable, passive = (results(tmp_path / "a.nc")[name] for name in ("stable", "passive"))
    for flags, said in ((stable, "predicted stable"), (passive, "passive: no hand makes them unstable")):
        share = share_in_percent(float(flags.mean()))
        assert f"{int(flags.sum())} of 12 points ({share}) are {said}" in answer.out
    assert not re.search(r"(stable|passive) +[│|]", answer.out), "in the table"
    rows = [row.split(",") for row in (tmp_path / "a.csv").read_text("utf-8").splitlines()[1:]]
    shares = {(float(x), float(y)): float(share) for x, y, share in rows}
    assert {*shares.values()} > {0.5}
    assert "<!-- share of the points that are stable -->" in (tmp_path / "a.svg").read_text("utf-8")
    for (x, y), share in shares.items():
        assert share == float(stable.sel({"touch.stiffness": x, "device.delay": y}).mean())


def test_without_a_variable_the_first_is_drawn_that_varies_by_more_than_its_uncertainty() -> None:
    from hapsim.chart.sweep_chart import names_to_draw, sweep_chart

    stiffness, unsure = np.array([100.0, 200.0, 300.0]), np.full(3, 0.01)
    known = {"predicted_k": stiffness, "measured_k": stiffness + 0.01, "measured_k_uncertainty": unsure}

    def drawn(**changed: Any) -> Any:
        columns = {name: (("x",), column) for name, column in (known | changed).items()}
        dataset = xarray.Dataset(columns, {"x": ("x", [1.0, 2.0, 3.0], {"units": "N/m"})})
        return sweep_chart(dataset, *names_to_draw(known, ["x"], None, [])).values.name

    assert drawn() == "predicted_k"
    assert drawn(measured_k=stiffness + 1.0) == "measured_k_off"
    assert drawn(predicted_k=np.full(3, 100.0), measured_k=np.full(3, 100.0)) == "measured_k_off"


def test_axes_have_units_and_no_font_is_looked_for_in_vain(
    hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib import font_manager

    one = [entry for entry in font_manager.fontManager.ttflist if entry.name == "DejaVu Sans"][:1]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", one)
    words = ("touch.stiffness=log:100:9000:3", "touch.damping=1,5", "--check", "--out", tmp_path / "a.nc")
    answer = hapsim("sweep", SCENE, *words, "--picture", tmp_path / "a.svg")
    assert "findfont" not in answer.err
    assert {"cmr10", "STIXGeneral"} <= {entry.name for entry in font_manager.fontManager.ttflist}
    drawn = (tmp_path / "a.svg").read_text("utf-8")
    assert "<!-- touch.stiffness (N/m) -->" in drawn
    assert "<!-- touch.damping (N·s/m) -->" in drawn
