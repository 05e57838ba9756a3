"""A description through its registers and back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from firmware_protocol.description import Description, from_registers, registers_of_a_description, to_registers

numbers = st.floats(allow_nan=False)
printable = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=16)
words = st.integers(0, 2**32 - 1)


@st.composite
def descriptions(draw: st.DrawFn) -> Description:
    channels = draw(st.integers(1, 16))
    per_channel = st.lists(numbers, min_size=channels, max_size=channels).map(tuple)
    return Description(
        name=draw(printable),
        rate_hz=draw(numbers),
        pacings=draw(st.integers(0, 7)),
        max_watchdog_samples=draw(st.integers(0, schema.MAX_WATCHDOG_SAMPLES)),
        position_scale=draw(per_channel),
        force_scale=draw(per_channel),
        force_limit=draw(per_channel),
        velocity_scale=draw(st.just(()) | per_channel.filter(any)),
        acceleration_scale=(acceleration := draw(st.just(()) | per_channel.filter(any))),
        sensors=draw(st.integers(0, 3)) << 1 | bool(acceleration),
        version=draw(words),
        schema_hash=draw(words),
    )


def plain(**changed: object) -> Description:
    description = Description("stick", 1000.0, 1, 100, (1e-6, 2e-6), (1e-3, 1e-3), (5.0, 6.0))
    return replace(description, **changed)  # type: ignore[arg-type]


@settings(max_examples=80, deadline=None)
@given(descriptions())
def test_a_description_comes_back_from_its_registers_as_it_was(description: Description) -> None:
    registers = to_registers(description)
    assert registers.shape == (schema.REGISTERS,)
    assert ((registers >= 0) & (registers < 2**32)).all()
    assert from_registers(registers) == description


@settings(max_examples=100, deadline=None)
@given(descriptions())
def test_the_registers_that_are_asked_for_are_all_that_a_description_needs(description: Description) -> None:
    every = to_registers(description)
    asked = np.zeros_like(every)
    for register in (
        schema.REG_VERSION,
        schema.REG_SCHEMA,
        schema.REG_CHANNELS,
        schema.REG_SENSORS,
        *registers_of_a_description(description.channels, description.sensors),
    ):
        asked[register] = every[register]
    assert from_registers(asked) == description


def test_scales_of_accelerations_are_read_only_from_a_board_that_declares_them() -> None:
    assert not [n for n in registers_of_a_description(16, 4) if n >= 160]
    assert [n for n in registers_of_a_description(2, 1) if n >= 160] == [160, 161, 176, 177]
    undeclared = from_registers(to_registers(plain(acceleration_scale=(1e-3, 1e-3))))
    assert (undeclared.acceleration_scale, undeclared.sensed) == ((), ())


def test_what_is_not_a_number_travels_too() -> None:
    returned = from_registers(to_registers(plain(rate_hz=math.nan, force_limit=(math.inf, -0.0))))
    assert math.isnan(returned.rate_hz)
    assert returned.force_limit == (math.inf, 0.0)
    assert math.copysign(1.0, returned.force_limit[1]) == -1.0


@pytest.mark.parametrize(
    ("name", "arrives"),
    [
        ("", ""),
        ("exactly sixteen.", "exactly sixteen."),
        ("a name that is longer than the field", "a name that is l"),
        ("Kraftrückmeldung", "Kraftr?ckmeldung"),
        ("ends\0here", "ends?here"),
        ("\x1b[2Jclear", "?[2Jclear"),
    ],
)
def test_a_name_is_cut_and_made_printable(name: str, arrives: str) -> None:
    assert from_registers(to_registers(plain(name=name))).name == arrives


@given(st.lists(words, min_size=4, max_size=4))
def test_whatever_a_device_holds_as_its_name_can_be_shown(held: list[int]) -> None:
    registers = to_registers(plain())
    registers[schema.REG_NAME : schema.REG_NAME + 4] = held
    name = from_registers(registers).name
    assert name.isascii()
    assert name == "" or name.isprintable()
    assert len(name) <= 16


def test_a_name_ends_at_its_first_zero_byte_whatever_stands_behind() -> None:
    registers = to_registers(plain())
    registers[schema.REG_NAME : schema.REG_NAME + 4] = [0x00006261, 0x44434241, 0, 0x41]
    assert from_registers(registers).name == "ab"


def test_a_watchdog_beyond_what_sample_numbers_distinguish_is_taken_for_the_longest() -> None:
    registers = to_registers(plain())
    registers[schema.REG_MAX_WATCHDOG] = 2**32 - 1
    assert from_registers(registers).max_watchdog_samples == schema.MAX_WATCHDOG_SAMPLES


@pytest.mark.parametrize("channels", [0, 17, 2**32 - 1])
def test_a_device_of_no_or_too_many_channels_is_an_error(channels: int) -> None:
    registers = to_registers(plain())
    registers[schema.REG_CHANNELS] = channels
    with pytest.raises(ValueError, match=f"{channels} channels"):
        from_registers(registers)


@pytest.mark.parametrize(
    "changed",
    [
        {"position_scale": (), "force_scale": (), "force_limit": ()},
        {"position_scale": (1.0,) * 17, "force_scale": (1.0,) * 17, "force_limit": (1.0,) * 17},
        {"force_scale": (1.0,)},
        {"force_limit": (1.0, 2.0, 3.0)},
        {"velocity_scale": (1.0,)},
        {"acceleration_scale": (1.0,)},
    ],
)
def test_a_description_that_does_not_fit_together_is_an_error(changed: dict[str, tuple[float, ...]]) -> None:
    with pytest.raises(ValueError, match="channel"):
        to_registers(plain(**changed))


@pytest.mark.parametrize(
    ("scale", "senses"),
    [
        ((), False),
        ((1e-3, 2e-3), True),
        ((0.0, 0.0), False),
        ((1e-3, 0.0), False),  # velocity is sensed on every channel or on none
        ((1e-3, -1e-3), False),
        ((1e-3, math.nan), False),
    ],
)
def test_a_device_senses_velocity_where_every_channel_has_a_scale_above_0(
    scale: tuple[float, ...], senses: bool
) -> None:
    description = plain(velocity_scale=scale)
    assert ("velocity" in description.sensed) == senses
    assert ("velocity" in from_registers(to_registers(description)).sensed) == senses


def test_each_pacing_has_its_bit() -> None:
    for pacings in range(8):
        description = plain(pacings=pacings)
        paced = [description.paces(p) for p in (schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP)]
        assert paced == [bool(pacings & 1), bool(pacings & 2), bool(pacings & 4)]
