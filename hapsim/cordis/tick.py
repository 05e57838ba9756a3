"""One sample of a scene: it takes positions, returns forces and moves masses. Compiled once, for every scene."""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.compiling.native import array_at, record_at
from hapsim.cordis.dispatch import CALLS, call_all
from hapsim.cordis.parameters import PARAMETERS, call_move
from hapsim.cordis.spring_energy import number_at, put_number, stored_at
from hapsim.cordis.stored_energy import call_evaluate

PROGRAM = np.dtype(
    [
        ("turn", np.int64),  # the row of positions that is this sample's; the other: the one before, then the next
        ("states", np.uint64, (2,)),  # addresses of the TickState at each turn
        ("rows", np.uint64, (2,)),  # and of the positions
        ("force", np.uint64),  # address of all points' forces
        ("single", np.int64),  # 1: positions and forces have single precision
        ("hands", np.int64),  # H device points, which come first among the points
        ("channel", np.uint64, (schema.MAX_CHANNELS,)),  # the device's channel of each
        ("senses", np.int64),  # 1: a link uses velocities
        ("velocity", np.uint64),  # address of the device points' velocities in m/s
        ("pick_up_values", np.uint64),  # address of the pick-ups' values of the last step
        ("settling", np.int64),  # 1: parameters moved with the last sample
        ("initialize", CALLS),
        ("retarget", CALLS),
        ("add_forces", CALLS),
        ("integrate", CALLS),
        ("place", CALLS),  # before another program takes over,
        ("carry_points", CALLS),  # and in one that does: first of all,
        ("carry_numbers", CALLS),  # after `initialize`,
        ("resume", CALLS),  # and last
        ("line", CALLS),  # on a LineQuery; none under `law: host`
        ("query", np.uint64, (4,)),  # addresses of that, and of its numbers, whole numbers and knots
        ("parameters", PARAMETERS),
        ("events", np.uint64),  # address of the EVENTS of loop/events.py; 0: none
    ],
    align=True,
)
"""A scene for compiled code."""

program_at = record_at(PROGRAM)
_doubles_at = array_at(np.float64)


@inlined
def start(program, measured):
    """Puts the device points at the hands, at rest, so that the first tick has no jump. `measured`: m, one value per
    channel of the device."""
    _set_at_rest(program, measured)
    call_all(program.initialize, program.states[np.uint64(program.turn)])


@inlined
def take_over(older, program, measured):
    """Starts a program that follows another in a running loop, instead of `start`: common modules continue from the
    older program's state, and new hands begin at rest."""
    call_all(older.place, older.states[np.uint64(older.turn)])
    state = program.states[np.uint64(program.turn)]
    _set_at_rest(program, measured)
    call_all(program.carry_points, state)
    set_hands(program, measured)
    call_all(program.initialize, state)
    call_all(program.carry_numbers, state)
    call_all(program.resume, state)
    program.settling = 1


@inlined
def tick(program, measured, velocity, force):
    """Moves the scene by one sample. `measured`: the device's positions in m, one per channel. `velocity`: its sensed
    velocities in m/s, else 0. `force`: receives the force in N on each channel that the scene uses."""
    turn = np.uint64(program.turn)
    program.turn = ONE - turn
    state = program.states[turn]
    _set_positions(program, program.rows[turn], measured)
    if program.senses:
        sensed = _doubles_at(program.velocity, program.hands)
        for h in range(np.uint64(program.hands)):
            sensed[h] = velocity[program.channel[h]]
    call_all(program.add_forces, state)
    _read_forces(program, force)
    call_all(program.integrate, state)


@inlined
def _rows(program):
    """Returns the addresses of the positions at this sample and at the one before."""
    turn = np.uint64(program.turn)
    return program.rows[turn], program.rows[ONE - turn]


@inlined
def _set_at_rest(program, measured):
    here, before = _rows(program)
    _set_positions(program, here, measured)
    _set_positions(program, before, measured)


@inlined
def set_hands(program, measured):
    """Puts the device points at the hands. Call it before `update_parameters` if energy is accounted for."""
    _set_positions(program, program.rows[np.uint64(program.turn)], measured)


@inlined
def update_parameters(program):
    """Moves live parameters, and points that depend on them, by one sample. Call it before the tick. With the next
    sample these points are at rest again."""
    parameters, moved = program.parameters, 0
    if parameters.posted != parameters.taken or parameters.left > 0 or parameters.gates > 0:
        moved = call_move(parameters.move, (parameters.address, *_rows(program)))
    if moved or program.settling:
        call_all(program.retarget, program.states[np.uint64(program.turn)])
        program.settling = moved


@inlined
def stored_energy(program, measured):
    """Returns the stored energy before the tick, J, with the hands at `measured`; 0 if it is not accounted for."""
    if program.parameters.stored == 0:
        return 0.0
    set_hands(program, measured)
    call_all(program.place, program.states[np.uint64(program.turn)])
    stored = stored_at(program.parameters.stored)
    return call_evaluate(stored.evaluate, (stored.address, *_rows(program), np.uint64(0)))


@inlined
def _set_positions(program, row, measured):
    for h in range(program.hands):
        put_number(row, h, program.single, measured[program.channel[np.uint64(h)]])


@inlined
def _read_forces(program, force):
    """Reads the force on each device point and sets it to zero."""
    for h in range(program.hands):
        force[program.channel[np.uint64(h)]] = number_at(program.force, h, program.single)
        put_number(program.force, h, program.single, 0.0)
