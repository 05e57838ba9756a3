"""The guards: no force beyond the limit, none that is no number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from loop_rig import CLOCKS, alike, frame, scene_of, scripted

from hapsim.compiling import entry
from hapsim.errors import GuardError, UsageError
from hapsim.loop.buffers import clip
from hapsim.loop.ring import LIMITED
from hapsim.running import run
from hapsim.scene import Scene
from tests import one_hand


@pytest.mark.usefixtures("leaps_allowed")
@pytest.mark.parametrize(
    ("device_limit", "scale", "most"),
    [
        (10.0, 0.3, 33),  # 33.3 counts: the rounding must not go up over the limit
        (1.1, 0.3, 3),  # 3.67 counts
        (0.3, 0.1, 3),  # 3 counts, though 0.3 / 0.1 is a little less in floating point
        (100.0, 0.5, 20),  # the scene's limit of 10 N is below the device's
        (10.0, 1e-9, 2**31 - 1),  # 32 bits reach only 2.147 N
    ],
)
def test_counts_on_the_wire_never_mean_more_than_the_limit(device_limit: float, scale: float, most: int) -> None:
    script = [frame(n, 100_000 * (-1) ** n) for n in range(20)]  # 0.1 m at 1000 N/m: 100 N and more
    with scripted(script, force_limit=(device_limit,), force_scale=(scale,)) as (scene, device):
        trace = run(scene, duration=0.02)
    sent = [heard.counts[0] for heard in device.forces]
    assert max(sent) == most
    assert min(sent) == -most
    assert trace.report.limited_ticks == 20
    assert np.all(trace.flags & LIMITED)


def test_a_mass_of_the_scene_that_diverges_stops_the_loop_once_the_hand_would_feel_it() -> None:
    ball = {"ball": {"type": "mass", "mass": 1e-6}, "touch": one_hand.touch(5000.0, between=["hand", "ball"])}
    scene = one_hand.scene_of(ball, device={"friction": 0.0}, mock={"initial": {"velocity": 1.0}})
    with pytest.raises(GuardError) as caught:
        run(scene, duration=5.0)
    assert np.isfinite(caught.value.trace.force).all()


@entry
def guarded(force, limit):
    """The guards as the loop has them woven in."""
    return math.isfinite(force), clip(force, limit)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_the_guard_sees_every_value_that_is_no_number(value: float) -> None:
    """It would not, were anything here compiled with fastmath."""
    assert guarded(1e300, 1.0)[0]
    assert not guarded(value, 1.0)[0]


FORCE_SCALE = 2.0**-10  # N per count
POSITION_SCALE = 2.0**-20  # m per count: at 1024 N/m a count of position asks for a count of force, without rounding
LIMIT = 5000  # counts
FAR = 2**31 - 1
EACH = {"position_scale": POSITION_SCALE, "force_scale": FORCE_SCALE, "force_limit": LIMIT * FORCE_SCALE}


def springs(scene: Scene, stiffness: float, **of_channel: dict[str, float]) -> Scene:
    """Every hand on a spring of `stiffness` N/m without a damper, except for the links that are named."""
    changes = {name: {"stiffness": stiffness, "damping": 0.0} | of_channel.get(name, {}) for name in scene.links}
    modules = {name: module.model_copy(update=changes.get(name, {})) for name, module in scene.modules.items()}
    return scene.model_copy(update={"modules": modules})


@pytest.mark.usefixtures("leaps_allowed")
@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_up_to_the_limit_a_force_leaves_as_it_is_beyond_it_the_limit(clock: str, channel: int) -> None:
    wanted = [0, 1, LIMIT - 1, LIMIT, LIMIT + 1, LIMIT + 2, 2 * LIMIT, FAR, LIMIT]
    wanted += [-counts for counts in wanted]
    others = [7, -8, 9]  # counts, of the channels that are below their limits

    def asked(counts: int) -> list[int]:
        return [counts if c == channel else others[c] for c in range(3)]

    script = [frame(n, *(-counts for counts in asked(wanted[n]))) for n in range(len(wanted))]
    scene = springs(scene_of(3, rate=100.0, device={"clock": clock}), 1024.0)
    with scripted(script, scene=scene, rate_hz=100.0, **alike(3, **EACH)) as (there, device):
        trace = run(there, duration=len(wanted) / 100.0)
    beyond = np.abs(wanted) > LIMIT
    leaves = np.clip(wanted, -LIMIT, LIMIT)
    np.testing.assert_array_equal(trace.asked_force[:, channel] / FORCE_SCALE, wanted)
    np.testing.assert_array_equal(trace.force_counts[:, channel], leaves)
    np.testing.assert_array_equal((trace.flags & LIMITED) != 0, beyond)
    assert trace.report.limited_ticks == beyond.sum() == 8
    # By the host's clock a tick that comes late replaces a force before it leaves: what does leave is the guarded one.
    assert {heard.number for heard in device.forces} <= set(range(len(wanted)))
    assert len(device.forces) == len(wanted) or clock == "host"
    for heard in device.forces:
        assert list(heard.counts) == asked(int(leaves[heard.number]))


NO_NUMBER: dict[str, tuple[dict[str, float], int, int]] = {
    "too large": ({"stiffness": 1.7e308}, -FAR, 3),
    "too small": ({"stiffness": 1.7e308}, FAR, 3),
    "nan": ({"damping": 1e308}, 0, 0),  # at rest: no velocity times an infinite B/T
}
"""A link's parameters, its hand's counts at sample 3, and the sample at which its force is not finite."""


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("clock", "channel", "kind"),
    [*((clock, 0, "too large") for clock in CLOCKS), ("device", 3, "too small"), ("device", 1, "nan")],
)
def test_one_channel_without_a_number_releases_all_of_them(clock: str, channel: int, kind: str) -> None:
    link, far, last = NO_NUMBER[kind]
    still = [-100] * 4
    still[channel] = 0
    moved = [far if c == channel else -100 for c in range(4)]
    scene = springs(scene_of(4, rate=100.0, device={"clock": clock}), 1024.0, **{f"touch{channel}": link})
    script = [frame(n, *(moved if n == 3 else still)) for n in range(6)]
    with scripted(script, scene=scene, rate_hz=100.0, **alike(4, **EACH)) as (there, device):
        with pytest.raises(GuardError, match="not a finite number at tick") as caught:
            run(there, duration=1.0)
        assert not device.armed
    assert caught.value.exit_status == 4
    trace = caught.value.trace
    assert trace.report.ending == "force not finite"
    assert trace.sample.tolist() == list(range(last + 1))
    assert np.isfinite(trace.asked_force[:-1]).all()
    assert np.isfinite(trace.asked_force[-1]).sum() == 3
    assert not np.isfinite(trace.asked_force[-1, channel])
    assert not trace.force_counts[-1].any()
    # What left: the forces of the samples before, and then the frame that disarms, with zeros.
    assert all(heard.number < last and 0 < max(heard.counts) <= LIMIT for heard in device.forces)
    assert [list(farewell.counts) for farewell in device.farewells] == [[0] * 4]


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_a_duration_that_cannot_be_run_is_refused(duration: float) -> None:
    with pytest.raises(UsageError, match="expected a finite number of seconds above 0"):
        run(scene_of(), duration=duration)
