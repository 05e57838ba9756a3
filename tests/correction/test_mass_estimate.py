"""The estimate of the mass: right within what it states, whatever else moves the hand or disturbs what is read."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hapsim import run
from hapsim.cli.live import live_line
from hapsim.cli.run_command import show_report
from hapsim.loop.counts import Progress
from hapsim.measuring.measure import measure
from hapsim.recording.report import Report
from hapsim.running import PeriodicExcitation
from hapsim.scene import Scene
from tests import one_hand

TOUCH = {"touch": one_hand.touch(2000.0, 5.0)}
DEVICE = {"mass": {"from": 0.1, "to": 0.4}, "correction": "adaptive"}


def scene_of(mass: float = 0.3, **mock: Any) -> Scene:
    """K = 2000, B = 5, and a mass that the scene knows to be between 0.1 and 0.4 kg."""
    return one_hand.scene_of(TOUCH, device=DEVICE, mock={"mass": mass} | mock)


def pushes(until: int, length: int) -> PeriodicExcitation:
    """2.5 N for 8 ms every 75 ms, to either side in turn, until this sample."""
    forces = np.zeros(length)
    for n, begin in enumerate(range(10, until, 75)):
        forces[begin : begin + 8] = 2.5 if n % 2 else -2.5
    return PeriodicExcitation(0, forces)


def estimated(report: Report) -> tuple[float, float, float]:
    """(kg, its standard uncertainty in kg, R²)"""
    (mass,), (uncertainty,), (explained,) = (
        report.estimated_mass_kg,
        report.estimated_mass_uncertainty_kg,
        report.mass_explained,
    )
    assert mass is not None
    assert uncertainty is not None
    assert explained is not None
    return mass, uncertainty, explained


def is_exact(report: Report) -> None:
    mass, uncertainty, explained = estimated(report)
    assert mass == pytest.approx(0.3, rel=1e-4)
    assert uncertainty < 1e-4
    assert explained > 0.999


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("seed", range(2, 6))
def test_random_devices_are_within_three_uncertainties(bench: Any, seed: int) -> None:
    """Noise, coarse counts, stalls, late forces, dry friction, a hand that pushes and one that knocks."""
    found = bench.estimated(seed, 1.5)
    assert found["known"]
    assert abs(found["off"]) < 3.0


@pytest.mark.parametrize(("noise", "within"), [(0.4e-6, 1e-3), (1e-6, 2e-3), (1e-5, 0.02)])
def test_noise_of_the_sensor_makes_no_mass_lighter(noise: float, within: float) -> None:
    for seed in range(2):
        mass, uncertainty, explained = estimated(
            run(scene_of(noise=noise, seed=seed), duration=1.0, excitation=pushes(1000, 1000)).report
        )
        assert mass == pytest.approx(0.3, rel=within)
        assert abs(mass - 0.3) < 3.0 * uncertainty < 3.0 * within * 0.3
        assert explained > 0.98


def test_before_anything_moves_nothing_is_known() -> None:
    report = run(scene_of(noise=1e-6), duration=0.5).report
    mass, uncertainty, explained = estimated(report)
    assert (mass, uncertainty, explained) == (pytest.approx(0.1), pytest.approx(0.3), 0.0)
    assert "0.1 ± 0.3 (not known" in table_of(report)


def test_the_last_known_estimate_stays_while_only_noise_moves() -> None:
    """Noise moves the hand through the scene's force, too: that tells nothing of its mass."""
    traces = [run(scene_of(noise=1e-5), duration=duration, excitation=pushes(1000, 4000)) for duration in (1.3, 2.5)]
    soon, later = (estimated(trace.report) for trace in traces)
    assert soon[0] == pytest.approx(0.3, rel=0.02)
    assert later == soon
    ages = [trace.report.mass_age_s[0] for trace in traces]
    assert ages[0] < 0.3
    assert ages[1] == pytest.approx(ages[0] + 1.2, abs=0.01)
    told = [table_of(trace.report) for trace in traces]
    assert "no motion showed it later" not in told[0]
    assert "s before the end: no motion showed it later)" in told[1]


def test_a_hand_that_pushes_slowly_is_not_taken_for_mass(bench: Any) -> None:
    """2 N at 1 Hz: without the differences that take it away, 10.7 kg."""
    hand = 2.0 * np.sin(2.0 * np.pi * np.arange(6000) / 1000.0)
    report = run_disturbed(bench, hand, np.zeros(6000, np.int64))
    mass, uncertainty, _ = estimated(report)
    assert mass == pytest.approx(0.3, rel=0.03)
    assert abs(mass - 0.3) < 3.0 * uncertainty


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("every", "what"), [(130, 20), (100, -1)], ids=["stalls of 20 ms", "lost positions"])
def test_lost_time_is_not_compared(bench: Any, every: int, what: int) -> None:
    """Lost time is skipped: the applied force is unknown, and a motion of two samples is not taken for one."""
    disturbed = np.zeros(6000, np.int64)
    disturbed[::every] = what
    report = run_disturbed(bench, np.zeros(6000), disturbed)
    assert what > 0 or report.lost_frames > 10
    is_exact(report)


def test_forces_that_were_late_in_a_row_are_not_compared() -> None:
    """Two late forces in a row are skipped: the applied one is unknown."""
    trace = run(scene_of(misses=0.05, seed=3), duration=2.0, excitation=pushes(2000, 2000))
    assert trace.report.deadline_misses > 60
    is_exact(trace.report)


def test_the_estimate_follows_a_grip() -> None:
    """The latest blocks alone tell the new mass, before the older ones are forgotten."""
    trace = run(scene_of(0.1, grips=((1.0, 0.38),)), duration=1.5, excitation=pushes(2000, 2000))
    assert estimated(trace.report)[0] == pytest.approx(0.38, rel=1e-3)


def test_k_and_b_are_as_uncertain_as_the_mass() -> None:
    for seed in range(2):
        found = measure(scene_of(noise=1e-5, seed=seed))
        _, uncertainty, _ = estimated(found.trace.report)
        assert found.k_uncertainty >= found.k * uncertainty / found.mass
        assert found.b_uncertainty >= found.b * uncertainty / found.mass
        assert abs(found.k - found.k / found.mass * 0.3) < 3.0 * found.k_uncertainty


def test_a_mass_that_the_forces_explain_little_of_has_a_warning() -> None:
    report = run(scene_of(), duration=0.5, excitation=pushes(500, 500)).report
    assert "explain" not in table_of(report)
    told = table_of(replace(report, estimated_mass_uncertainty_kg=(0.01,), mass_explained=(0.83,)))
    assert "0.3 ± 0.01 (the forces explain 83 % of the latest motion)" in told


def test_the_uncertainty_is_in_the_json_and_in_the_live_line(hapsim: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    mock = {"mass": 0.3, "initial": {"velocity": 0.1}}
    path.write_text(json.dumps(one_hand.document_of(TOUCH, device=DEVICE, mock=mock)))
    answer = hapsim("run", path, "--duration", 0.5, "--json")
    document = answer.document
    (mass,), (uncertainty,), (explained,) = (
        document[name] for name in ("estimated_mass_kg", "estimated_mass_uncertainty_kg", "mass_explained")
    )
    assert abs(mass - 0.3) < 3.0 * uncertainty < 1e-3
    assert 0.999 < explained <= 1.0
    screen = io.StringIO()
    with live_line(Console(file=screen, width=200)) as tell:
        tell(Progress("running", estimated_mass_kg=(None, 0.3), estimated_mass_uncertainty_kg=(None, 0.012)))
    assert screen.getvalue().endswith(" · mass 0.3 ± 0.01 kg\n")


def run_disturbed(bench: Any, hand: Any, stalls: Any) -> Report:
    tried = bench.Tried("", scene_of(), hand, stalls)
    return run(
        tried.scene,
        duration=1.5,
        transport="loopback",
        excitation=pushes(1500, 1500),
        between=lambda mock: bench.Disturbed(mock, tried),
    ).report


def table_of(report: Report) -> str:
    out = io.StringIO()
    show_report(Console(file=out, width=200), report)
    return out.getvalue()
