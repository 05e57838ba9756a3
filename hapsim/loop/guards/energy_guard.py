"""The energy guard: it stops the loop before a scene gives the hand more energy than any passive object could.

**The energy.** Time-domain passivity (Hannaford and Ryu, IEEE Trans. Robotics and Automation 18(1), 2002). The energy
that the simulated force has given to the hand, summed over channels and samples, is

    S += f dx - b0 dx² / T,     dx = x[n] - x[n-1].

f is the force that acted from sample n-1 to n. With a delay of d samples it answers sample n-1-d; for a fraction of a
sample it is the weighted mean of two answers. b0 is the declared friction, which dissipates at least b0 dx²/T. An
excitation counts as the hand's force.

For a spring K and a backward damper B, S never exceeds the spring's energy at the beginning, for any positions,
quantised or not, if b0 >= K T (1/2 + d) + |B|. Without delay, the spring held at x[n-1] gives

    -K x[n-1] dx[n] = -K/2 (x[n]² - x[n-1]²) + K/2 dx[n]²,

a difference of stored energies and K T/2 · dx²/T. Each further sample of delay adds K dx[n-j] dx[n], at most
K/2 (dx[n-j]² + dx[n]²): summed, at most K T · dx²/T. The damper, however late, gives -B/T dx[m] dx[n], summed at most
|B| dx²/T. Friction dissipates all of it. That is Colgate's condition (`theory/hand/wall_passivity.py`) sample by
sample. A clipped force makes the spring softer; two channels are two sums. For a hand with x and y, f dx and dx² are
scalar products, and K is the largest stiffness in any direction; the limit is a circle, so that a clipped spring still
is one.

**Points at other ports** move without this port's force. What they give to the links that they share with it, -f dx,
with b0 dx² / T of the device that moves them, is the scene's own energy, like that of a change: S begins as if the hand
held the stretch of the link. f is clipped as a force of this port is.

**A board that follows lines** (`law: board`) works out its force N times per sample, from a position that is at most
1/2 + board_delay local periods old in the mean. The force of a sample (board_law.py) does the work of the line's
potential, whatever the host's delay, so that of a spring to a ground S never exceeds the energy at the beginning if
b0 + b >= k T/N (1/2 + board_delay). For a law with corners the lines differ from sample to sample, and S counts what
the hand gains by that. Bounds only take energy: at a bound the force is that of a softer spring.

**In admittance** the energy is measured: the sensed force f of the hand on the handle, and where that is, give

    S += -(f[n-1] + f[n])/2 dx - e dx,

exactly for a spring in the hand, whatever the delay; e is the excitation, which is none of the scene's. b0 is 0: the
simulated damping may take only what the delay gives, or a stiff hand would swing on it for ever.

Energy from the hand is its credit, but no more than a scene could hold: S stays above -`credit`. S begins at minus the
energy that the scene holds at the first sample (cordis/stored_energy.py), without modules that no link connects to a
hand. A change of K while the scene runs adds (K[n] - K[n-1]) x[n]²/2 to the stored energy. This is subtracted from S
when the change acts, with its sign, for all modules, and a tank bounds it. Clipped credit makes S too high by
`clipped`. When a change removes energy, the guard therefore forgives a rise above 0 up to `clipped`, and a passive
scene stays below 0 whatever changes. The guard trips when S exceeds `limit`.

A link with a gain gives one hand more than it takes from the other. Then the energy of each hand, its friction's and
the stored energy count times its weight (scene/scaled_links.py), with which that link is passive again, and the proof
holds.

**Two accounts.** The proof holds for forces in time; the account SCENE counts those (force_history.py). Late forces
also give energy, but the host causes that: no reason to stop a run in which a hand knocks while the host stalls. The
account LATE counts the forces that acted, as far as the device reports them, with a larger `limit` and LATE_SWINGS
episodes.

**Swinging at the limit.** A swing that the force limit clips can keep its size while friction dissipates all the
energy. So the guard also trips after SWINGS episodes in a row, each beginning within GAP_S (GAP_SAMPLES at least) of
the one before, if the force's work over them is at least the friction's, and more than `swing_limit`. An episode begins
when the scene's own force, without an excitation, reaches the limit on another side or after a sample within it. For a
hand with x and y the limit is a circle here, so that a spring holds the same energy wherever its force reaches it, and
another side is a direction more than 90 degrees away. None begins at arming, when wound-up springs hold more than at
any crossing, or after lost positions. The sums begin anew when the force did less work than friction: between two
crossings of the limit at one place a spring holds the same energy, so any gain comes from the sampling. They also begin
anew when a parameter changes, which moves the crossing. A hand that presses, knocks or shakes a passive object loses
energy from episode to episode.

**Shaking at the limit.** A mass that diverges, or a damper too large for the rate, throws the force from limit to limit
so fast that the hand hardly moves. So the guard also trips after SHAKES turns in a row of one channel's force from one
limit to the other, if the requested force does not fall from turn to turn, and each turn is

* within SHAKE_SAMPLES of the one before: friction ends such a fast swing of a passive object at once;
* or within SHAKE_S, at SHAKE_OVERLOAD times the limit: no hand shakes at 10 Hz and more, and a mass that swings so on a
  passive object comes to rest;
* or within GAP_S, at GAP_OVERLOAD times the limit: no hand stretches anything so far.

Late forces swing more slowly, and the device does not report how late they are, so that no account is right. The guard
trips after SWINGS turns in a row, however slow, if every force was late and each peak equals the one two turns before
within PEAK_TOLERANCE: a loop repeats itself so, a hand does not.

**Stricter rules** apply to a scene that is predicted unstable and runs at its user's request. Episodes count from
STRICT_SHARE of the limit on, to find a contact that bounces below it. Friction may exceed the work by STRICT_TOLERANCE
of it. Every turn from limit to limit within GAP_S is shaking, and SWINGS of them suffice.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import record_at
from hapsim.cordis.stored_energy import Tank, tank_at
from hapsim.loop.buffers import clip
from hapsim.loop.force_history import IN_ALL, IN_TIME, OF_SCENE, acting_force, history_at
from hapsim.loop.guards.slew import NO_LIMIT
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.number_format import duration, rounded_down, rounded_up
from hapsim.scene.scaled_links import energy_weights

ENERGY_EXCEEDED = -22
STEADINESS_ADVICE = "`hapsim doctor` reports what would help this machine"
STEADINESS_ADVICE += ", and `--realtime` requests it" if sys.platform == "linux" else ""
REFILL_S = 10.0  # time in which the tank of live changes fills
_MANY_SLEWED = 0.1  # of all ticks
MOST_STORED = 40.0  # credits: with infinite stored energy the guard would never trip
LATE_LIMIT_FACTOR, LATE_SWINGS = 5.0, 64  # times the usual limit
SWINGS, GAP_S, GAP_SAMPLES = 16, 0.5, 3
SHAKES, SHAKE_SAMPLES, SHAKE_S, SHAKE_OVERLOAD, GAP_OVERLOAD = 64, 6, 0.05, 1.5, 100.0
PEAK_TOLERANCE = 0.01
STRICT_SHARE, STRICT_TOLERANCE = 0.02, 0.01
_FOREVER = 1 << 62
_EQUAL_PEAK = 0.999  # share of the last peak: a sample need not fall on the peak

GIVEN, SWINGING, SHAKING = 1, 2, 3  # cause of the trip: the energy, or swinging or shaking at the limit
SCENE, LATE = 0, 1  # the accounts: of the forces in time, and of those that acted
_EACH, _ACCOUNTS = (schema.MAX_CHANNELS,), (2,)

ENERGY_GUARD = np.dtype(
    [
        ("weight", np.float64, _EACH),  # of the energy of each channel
        ("friction_per_step", np.float64, _EACH),  # b0/T, N/m, times the weight
        ("limit", np.float64, _ACCOUNTS),  # J
        ("swing_limit", np.float64, _ACCOUNTS),  # J, of the work over episodes
        ("credit", np.float64),  # J
        ("tank", np.uint64),  # address of the TANK of live changes
        ("taken", np.float64),  # J, its `spent` at the last sample
        ("changed_ticks", np.int64),  # of that TANK, at the last sample
        ("begun", np.int64),  # 1: there was a sample
        ("most_stored", np.float64),  # J, most of the stored energy that counts at the first sample
        ("given", np.float64, _ACCOUNTS),  # S, J
        ("clipped", np.float64, _ACCOUNTS),  # J, of the credit of the hand
        ("position", np.float64, _EACH),  # m, of the last sample
        ("senses", np.int64),  # 1: admittance,
        ("hand_force", np.float64, _EACH),  # N, sensed at the last sample
        ("side", np.int64, _EACH),  # on which the force exceeds the limit; 0: neither
        ("asked", np.float64, _EACH),  # N, the scene's force of the last sample
        ("most_gap", np.int64),  # samples from one episode to the next
        ("gap", np.int64),  # samples since this one began
        ("swings", np.int64, _ACCOUNTS),  # episodes in a row
        ("work", np.float64, _ACCOUNTS),  # J, of the force over these,
        ("gained", np.float64, _ACCOUNTS),  # and the rest of it beyond friction
        ("most_turn", np.int64),  # samples from one turn to the next
        ("last_side", np.int64, _EACH),  # on which each channel's force was clipped last,
        ("turn", np.int64, _EACH),  # samples since it turned to that side,
        ("peak", np.float64, _EACH),  # N, the largest requested force since,
        ("least_peak", np.float64, _EACH),  # N, the least of these
        ("turns", np.int64, _EACH),  # and turns in a row
        ("peaks", np.float64, (2 * schema.MAX_CHANNELS,)),  # N, of the last two turns
        ("repeats", np.int64, _EACH),  # turns in a row that equal the one two before, with late forces
        ("shakes", np.int64),  # the most turns in a row
        ("elapsed", np.int64),  # samples since the first
        ("unstable_until", np.int64),  # sample; before it the scene is predicted unstable; another thread writes it
        ("why", np.int64),  # GIVEN, SWINGING, SHAKING
        ("account", np.int64),  # SCENE, LATE
    ],
    align=True,
)

_energy_at = record_at(ENERGY_GUARD)


@hook
def judge_energy(energy, tick):
    """Adds the energy of the last `gap` samples. Returns ENERGY_EXCEEDED if the guard trips, else 0."""
    energy, tick = _energy_at(energy), tick_at(tick)
    history, io, gap = history_at(tick.history), io_at(tick.io), tick.gap
    has_begun = energy.begun != 0
    if has_begun:
        energy.elapsed += gap
    else:
        energy.begun = 1
        energy.given[:] = -(tick.held if tick.held < energy.most_stored else energy.most_stored)  # also NaN
    begins = _update_sides(energy, history, io, gap) and gap == 1 and has_begun
    energy.gap += gap
    follows = energy.gap <= energy.most_gap
    energy.gap = 0 if begins else energy.gap
    tank = tank_at(energy.tank)
    added, energy.taken = tank.spent - energy.taken, tank.spent
    added += _given_by_others(energy, io, gap)
    tank.level = min(tank.capacity, tank.level + gap * tank.refill)
    if energy.changed_ticks != tank.changed_ticks:
        energy.changed_ticks = tank.changed_ticks
        energy.swings[:] = 0
        energy.work[:], energy.gained[:] = 0.0, 0.0
    for account in range(2):
        work, lost = _energy_of(energy, history, io, account, gap) if has_begun else (0.0, 0.0)
        _take_account(energy, account, work - lost, added)
        _count_swing(energy, account, work, lost + added, begins, follows)
        if energy.why == 0 and energy.given[account] > energy.limit[account]:
            energy.why, energy.account = GIVEN, account
        most = SWINGS if account == SCENE else LATE_SWINGS
        has_swung = energy.swings[account] >= most and energy.work[account] > energy.swing_limit[account]
        if energy.why == 0 and has_swung:
            energy.why, energy.account = SWINGING, account
    for c in range(io.channels):
        energy.position[c] = io.position_counts[c] * io.position_scale[c]
        energy.hand_force[c], energy.asked[c] = io.hand_force[c], io.asked[c]
        if energy.why == 0 and energy.repeats[c] >= SWINGS:
            energy.why, energy.account, energy.shakes = SHAKING, LATE, energy.repeats[c]
    if energy.why == 0 and energy.shakes >= (SWINGS if _is_unstable(energy) else SHAKES):
        energy.why = SHAKING
    return ENERGY_EXCEEDED if energy.why != 0 else 0


@helper
def _energy_of(energy, history, io, account, gap):
    """Returns (work of the force, least work of friction) since the last sample, J."""
    work, lost = 0.0, 0.0
    column = IN_TIME if account == SCENE and energy.senses == 0 else OF_SCENE
    for c in range(io.channels):
        way = io.position_counts[c] * io.position_scale[c] - energy.position[c]
        force = -0.5 * gap * (energy.hand_force[c] + io.hand_force[c]) if energy.senses else 0.0
        for i in range(gap):
            force += acting_force(history, column + c, i)
            force -= acting_force(history, IN_ALL + c, i) if energy.senses else 0.0
        work += energy.weight[c] * force / gap * way
        lost += energy.friction_per_step[c] * way * way / gap
    return work, lost


@inlined
def _given_by_others(energy, io, gap):
    """Returns the energy that points at other ports gave since the last sample, with what their friction takes, J."""
    given = 0.0
    for c in range(np.uint64(io.away_first), np.uint64(io.away_end)):
        way = io.measured[c] - energy.position[c] if energy.elapsed > 0 else 0.0
        force = clip(energy.asked[c], io.force_limit[c])
        given += energy.friction_per_step[c] * way * way / gap - energy.weight[c] * force * way
        energy.position[c], energy.asked[c] = io.measured[c], io.asked[c]
    return given


@helper
def _take_account(energy, account, gained, added):
    """Adds to S. A hand's credit is at most `credit`, plus the energy that changes `added`. A change that removes
    energy also removes some that had raised S while the credit was clipped: that much is forgiven, and no more."""
    total = energy.given[account] + gained
    given = max(total, min(energy.given[account], -energy.credit))
    clipped = energy.clipped[account] + given - total
    forgiven = min(max(given - added - max(given, 0.0), 0.0), clipped)
    energy.clipped[account] = clipped - forgiven
    energy.given[account] = given - added - forgiven


@helper
def _count_swing(energy, account, work, lost, begins, follows):
    """Adds to the sums over the episodes of swinging at the limit. `begins`: an episode begins with this sample."""
    energy.work[account] += work
    energy.gained[account] += work - lost
    if begins:
        least = -STRICT_TOLERANCE * energy.work[account] if _is_unstable(energy) else 0.0
        if follows and energy.swings[account] > 0 and energy.gained[account] >= least:
            energy.swings[account] += 1
        else:
            energy.swings[account] = 1
            energy.work[account] = energy.gained[account] = 0.0


@inlined
def _update_sides(energy, history, io, gap):
    """Updates the side of each channel's force, and counts turns. Returns whether an episode begins."""
    begins = False
    from_on = STRICT_SHARE if _is_unstable(energy) else 1.0
    for c in range(io.channels):
        limit, wanted = io.force_limit[c], io.asked[c] + io.excitation[c]
        side = _side_of(io.asked[c], from_on * limit)
        enters = side != 0 and side != energy.side[c] if io.to_next[c] == 0 else _enters(energy, io, c, from_on)
        begins = begins or enters
        energy.side[c] = side
        side = _side_of(wanted, limit)
        energy.turn[c] += gap
        if side != 0 and side != energy.last_side[c]:
            _count_turn(energy, c, limit, history.late)
            energy.last_side[c], energy.turn[c], energy.peak[c] = side, 0, 0.0
        energy.peak[c] = max(energy.peak[c], abs(wanted))
    return begins


@helper
def _enters(energy, io, c, from_on):
    """Returns whether the force of a hand with several channels reaches the limit in another direction, or after a
    sample within it."""
    now = before = along = 0.0
    other = np.uint64(c)
    while True:
        force, last = io.asked[other] / io.force_limit[other], energy.asked[other] / io.force_limit[other]
        now, before, along = now + force * force, before + last * last, along + force * last
        other += io.to_next[other]
        if other == np.uint64(c):
            break
    return now > from_on * from_on and not (before > from_on * from_on and along > 0.0)


@helper
def _is_unstable(energy):
    """Returns whether the scene is predicted unstable and runs by request."""
    return energy.elapsed < energy.unstable_until


@helper
def _side_of(force, limit):
    return 1 if force > limit else -1 if force < -limit else 0


@inlined
def count_turn(own, c, peak, is_none):
    """Counts a turn from one limit to the other, with this peak since the one before, in `turns` of a guard's record:
    they begin anew where the peak falls, and end where this `is_none`."""
    if is_none:
        own.turns[c], own.least_peak[c] = 0, math.inf
    elif peak < _EQUAL_PEAK * own.least_peak[c]:
        own.turns[c], own.least_peak[c] = 1, peak
    else:
        own.turns[c] += 1
        own.least_peak[c] = min(own.least_peak[c], peak)


@helper
def _count_turn(energy, c, limit, late):
    peak = energy.peak[c]
    turn = energy.turn[c]
    over = 1.0 if turn <= SHAKE_SAMPLES else SHAKE_OVERLOAD if turn <= energy.most_turn else GAP_OVERLOAD
    if _is_unstable(energy):
        energy.turns[c] = energy.turns[c] + 1 if turn <= energy.most_gap else 0
    else:
        count_turn(energy, c, peak, turn > energy.most_gap or peak < over * limit)
    before = energy.peaks[2 * c]
    is_alike = energy.most_turn < turn <= late and abs(peak - before) <= PEAK_TOLERANCE * before
    energy.repeats[c] = energy.repeats[c] + 1 if is_alike else 0
    energy.peaks[2 * c], energy.peaks[2 * c + 1] = energy.peaks[2 * c + 1], peak
    energy.shakes = max(energy.shakes, energy.turns[c])


def set_predicted_unstable(energy: Any, unstable: bool, samples: int = 0) -> None:
    """Sets whether the scene is predicted unstable after a change of `samples`, and runs by request. The stricter rules
    also apply during a change to or from such a scene."""
    if unstable:
        energy.unstable_until = _FOREVER
    elif is_strict(energy):
        energy.unstable_until = energy.elapsed + samples


def is_strict(energy: Any) -> bool:
    """Returns whether the rules for a scene that is predicted unstable apply now."""
    return bool(energy.elapsed < energy.unstable_until)


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, limit_j, energy = setting.scene, setting.bounds.energy_limit, loop.energy_guard
    if not math.isfinite(limit_j):
        return None
    force_limit, scales = scene.device.force_limit, scene.device.scales(scene.channels)
    usual_j, credit_j = force_limit * min(one.energy for one in scales), force_limit * max(one.credit for one in scales)
    energy.tank = Tank(loop.tank, capacity_j=limit_j, refill_j=limit_j / (REFILL_S * scene.rate)).address
    energy.senses = scene.device.is_admittance
    energy.weight[:] = 1.0
    for name, weight in energy_weights(scene).items():
        if hand := scene.device_points.get(name):
            energy.weight[hand.channel] = weight
    friction = 0.0 if energy.senses else np.array(scene.device.frictions(scene.channels))
    energy.friction_per_step[: scene.channels] = energy.weight[: scene.channels] * friction * scene.rate
    for one in scene.away:
        energy.friction_per_step[one.channel] = one.friction * scene.rate
    late_j = max(limit_j, LATE_LIMIT_FACTOR * usual_j)
    energy.limit[:], energy.swing_limit[:] = (limit_j, late_j), (min(limit_j, usual_j), late_j)
    energy.credit, energy.most_stored = credit_j, MOST_STORED * credit_j
    energy.most_gap = max(GAP_SAMPLES, round(GAP_S * scene.rate))
    energy.most_turn = round(SHAKE_S * scene.rate)
    energy.least_peak[:] = math.inf
    return energy


def _sentence(run: EndedRun) -> str:
    """Returns the finding, and a remedy for late forces."""
    energy, report = run.loop.energy_guard, run.report
    why, account = int(energy.why), int(energy.account)
    units = run.scene.units
    cause = "each time as far, by late forces" if account == LATE else "faster than any hand moves"
    on_what = "on a scene that is predicted unstable" if is_strict(energy) else ""
    if why == SWINGING:
        found = (
            f"the force swung {on_what or 'at its limit'}: {energy.swings[account]} times in a row, the last at tick "
            f"{report.ticks}, and gave the hand {units(energy.work[account], 'J', rounded_up)} over these, above the "
            f"limit of {units(energy.swing_limit[account], 'J', rounded_down)} and no less than the declared friction "
            "takes"
        )
    elif why == SHAKING:
        found = (
            f"the force shook at its limit: from one side to the other {energy.shakes} times in a row, the last at "
            f"tick {report.ticks}, {on_what or cause}"
        )
    else:
        found = (
            f"by tick {report.ticks} {'late forces' if account == LATE else 'the scene'} had given the hand "
            f"{units(energy.given[account], 'J', rounded_up)} more than it received, above the limit of "
            f"{units(energy.limit[account], 'J', rounded_down)}"
        )
    return f"{found}; the last force was not sent{_late_advice(report) if account == LATE else ''}"


def _late_advice(report: Any) -> str:
    late_s = ((report.age_samples.max or 1.0) - 1.0) / report.nominal_rate_hz
    lost = f", and {report.lost_frames} positions were lost" if report.lost_frames else ""
    return (
        f". {report.deadline_misses} forces were up to {duration(late_s)} late{lost}; in time the scene would have "
        f"given no more than it may. {STEADINESS_ADVICE} (hapsim/STABILITY.md)"
    )


def _advice(run: EndedRun) -> str:
    """Returns the remedy: first the slew limit, if it held the force back in many ticks. "" for late forces."""
    energy, report, slew = run.loop.energy_guard, run.report, run.loop.slew
    if int(energy.account) == LATE:
        return ""
    advice = "" if is_strict(energy) else "No passive object does that. "
    if report.slewed_ticks > _MANY_SLEWED * report.ticks and not report.wrong_sensor:
        limited, soft = int(slew.step[0]) < NO_LIMIT, float(slew.soft_samples) > 0.0
        by = " or ".join(["device.slew_limit"] * limited + ["device.soft_start"] * soft)
        advice = (
            f"{by} held the force back in {report.slewed_ticks} of {report.ticks} ticks, which predictions ignore: "
            f"a force that comes late can shake what is stable otherwise. Change it first. {advice}"
        )
    limit = (
        "For a scene that is meant to give energy, set device.energy_limit"
        if int(energy.why) == GIVEN
        else "A larger device.energy_limit does not change that"
    )
    return (
        f"{advice}`hapsim check` reports what would make the scene stable; less stiffness, more real friction, a "
        f"higher rate or a shorter delay. {limit} (hapsim/STABILITY.md)"
    )


GUARD = Guard(
    "energy_guard",
    ENERGY_GUARD,
    {Stage.JUDGE: judge_energy},
    _set_up,
    ENERGY_EXCEEDED,
    "scene diverging",
    _sentence,
    _advice,
    reads_history=True,
)
