"""A curve with two branches: its force, the energy that it takes and stores, its memory through changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.branch_law import BranchLaw
from hapsim.cordis.offline import start, take_over, ticks
from hapsim.cordis.program import compile_scene
from hapsim.cordis.succession import take_over_from
from hapsim.errors import SceneError, UsageError
from hapsim.running import start as begin
from hapsim.scene import Initial, Mock, Scene, parse_scene
from tests.branch_scenes import BUTTON, Kernel, branch_scene, lost_on, on_way, random_curve, random_paths, work

CYCLE_J = 0.471777778e-3


@pytest.mark.parametrize(("precision", "within"), [("double", 1e-12), ("single", 3e-4)])
def test_its_force_is_that_of_a_spring_and_a_slider(precision: str, within: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        curve = random_curve(rng)
        kernel = Kernel(branch_scene(curve, precision=precision))
        for path in random_paths(rng, curve, 3):
            way = on_way(curve, path)
            np.testing.assert_allclose(kernel.on(way.x), way.force, atol=within * np.abs(way.force).max() + 1e-15)


def test_a_cycle_takes_the_area_between_the_branches_less_the_two_turns() -> None:
    way = on_way(BUTTON, [0.0, 0.2e-3, 2.8e-3, 0.2e-3, 2.8e-3, 0.2e-3])
    force = Kernel(branch_scene(BUTTON)).on(way.x)
    ends = np.flatnonzero(way.x == 0.2e-3)
    assert work(way.x[ends[-2] : ends[-1] + 1], force[ends[-2] : ends[-1] + 1]) == pytest.approx(CYCLE_J, rel=1e-9)
    law = branch_scene(BUTTON).links["curve"].law()
    assert isinstance(law, BranchLaw)
    assert law.cycle_energy(0.2e-3, 2.8e-3) == pytest.approx(CYCLE_J, rel=1e-9)


def test_no_closed_path_takes_energy_from_it_and_it_stores_what_it_gives_back() -> None:
    """tools/bench/branches has 200 curves."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        curve = random_curve(rng)
        kernel = Kernel(branch_scene(curve))
        for path in random_paths(rng, curve, 5):
            taken, lost = lost_on(kernel, curve, path)
            assert taken >= -1e-15
            assert lost >= -1e-15


@pytest.mark.parametrize("z", [-1.0, -0.4, 0.3, 1.0])
def test_while_it_is_stuck_all_work_is_stored_and_a_sliding_hand_loses_the_rest(z: float) -> None:
    """Sliding it loses h less the mean of h over the last half of the turn."""
    kernel, turn = Kernel(branch_scene(BUTTON)), BUTTON["turn"]
    first = [0.0, 2.9e-3 if z < 0.0 else 0.1e-3, 2e-3]  # comes on the branch of z
    begin = on_way(BUTTON, [*first, 2e-3 - np.sign(z) * (1.0 - abs(z)) * turn / 2.0])
    kernel.on(begin.x)
    before = kernel.energy
    for way, slides in ((-np.sign(z) * 0.3 * turn, False), (np.sign(z) * 3.0 * turn, True)):
        path = [*first, begin.x[-1], begin.x[-1] + way]
        on = on_way(BUTTON, path)
        force = kernel.on(on.x)
        spent = work(on.x[begin.x.size - 1 :], force[begin.x.size - 1 :])
        if slides:
            assert spent - (kernel.energy - before) > 1e-6
        else:
            assert spent == pytest.approx(kernel.energy - before, rel=1e-9, abs=1e-16)


@pytest.mark.parametrize(("z", "stiffness"), [(-1.0, 2416.67), (0.0, 2458.33), (1.0, 2500.0)])
def test_stuck_it_is_a_bristle_whose_slope_depends_on_z(z: float, stiffness: float) -> None:
    x, step, turn = 0.9e-3, 1e-10, BUTTON["turn"]
    assert isinstance(turn, float)
    come = [0.0, x + (1.0 - z) * turn / 2.0, x] if z >= 0.0 else [0.0, 2e-3, x]
    way = on_way(BUTTON, [*come, x - step if z > 0.0 else x + step])
    force = Kernel(branch_scene(BUTTON)).on(way.x)
    assert way.z[-3] == pytest.approx(z, abs=1e-9)
    slope = (force[-1] - force[-3]) / (way.x[-1] - way.x[-3])
    assert slope == pytest.approx(stiffness, abs=0.01)


@pytest.mark.parametrize("change", [{"turn": 5e-4}, {"press": [[0.0, 0.1], [3e-3, 3.0]]}])
def test_a_changed_curve_goes_on_between_the_branches_where_the_old_one_was(change: dict[str, object]) -> None:
    older, newer = (branch_scene(BUTTON | more) for more in ({}, change))
    programs = compile_scene(older), compile_scene(newer)
    x = on_way(BUTTON, [0.0, 2e-3, 2e-3 - 3e-5]).x[:, None].copy()
    force = np.zeros_like(x)
    start(programs[0], x[0])
    ticks(programs[0], x, np.zeros_like(x), force, len(x))
    take_over_from(programs[0], older, programs[1], newer)
    take_over(programs[0], programs[1], x[-1])
    ticks(programs[1], x[-1:], np.zeros_like(x[-1:]), force[-1:], 1)
    law = newer.links["curve"].law()
    assert isinstance(law, BranchLaw)
    at = law.knots, law.half
    z = (0.5e-4 - 3e-5) / law.reach
    mean, half = np.interp(x[-1, 0], *np.array(at[0]).T), np.interp(x[-1, 0], np.array(at[0])[:, 0], at[1])
    assert -force[-1, 0] == pytest.approx(mean + z * half, rel=1e-9)


def test_its_record_is_replayed_to_the_bit(hapsim: Any, tmp_path: Path) -> None:
    scene = branch_scene(BUTTON).model_copy(update={"mock": Mock(initial=Initial(velocity=0.1))})
    with begin(scene, duration=0.3, record=tmp_path / "run.trace") as session:
        session.wait()
    assert (
        "300 samples, 0 changes: all forces are identical, to the last bit"
        in hapsim("replay", tmp_path / "run.trace").out
    )


def test_where_it_cannot_be_it_is_refused_in_words() -> None:
    curve = "{press: [[0, 0], [0.01, 2]], release: [[0, 0], [0.01, 1]]}"
    plane = f"""version: 1
rate: 1000
space: 2
device: {{mass: 0.2}}
modules:
  hand: {{type: device, channels: [0, 1]}}
  wall: {{type: ground}}
  it: {{type: nonlinear, between: [hand, wall], force_over_distance: {curve}}}
"""
    with pytest.raises(SceneError, match=r":8:\d+: force_over_distance: found two branches in a scene with space: 2"):
        parse_scene(plane)
    of_board = r"found board, but curve is none of the links .* \(curves with two branches\)"
    with pytest.raises(UsageError, match=of_board):
        compile_scene(branch_scene(BUTTON, law="board"))
    proxy = branch_scene(BUTTON).model_dump()
    proxy["modules"]["cup"] = {"type": "proxy", "mass": 0.02, "hand": "hand", "stiffness": 700.0}
    proxy["modules"]["curve"]["between"] = ("cup", "wall")
    with pytest.raises(ValueError, match="a proxy, at an end of a nonlinear, which has a memory"):
        Scene.model_validate(proxy)
