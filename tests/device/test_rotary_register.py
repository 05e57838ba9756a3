"""Register 13: a device declares which of its channels turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from firmware_protocol import schema
from firmware_protocol.description import Description, from_registers, registers_of_a_description, to_registers
from hapsim.device.mock.assemble_mock import assemble_mock, describe_mock
from hapsim.device.mock.terminal import serving
from hapsim.errors import UsageError
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene


def scene_of(*motion: str) -> Scene:
    hands = {f"hand{channel}": {"type": "device", "channel": channel} for channel in range(len(motion))}
    device = {"clock": "device", "mass": 0.2, "motion": list(motion)}
    return Scene.model_validate({"version": 1, "rate": 500.0, "device": device, "modules": hands})


def described(rotary: int, channels: int = 2) -> Description:
    return replace(describe_mock(scene_of(*["linear"] * channels)), rotary=rotary)


def test_the_mock_of_a_rotary_scene_declares_each_channel_that_turns() -> None:
    registers = to_registers(describe_mock(scene_of("linear", "rotary", "rotary")))
    assert registers[13] == registers[schema.REG_ROTARY] == 0b110
    assert from_registers(registers).motions == ("linear", "rotary", "rotary")
    assert schema.REG_ROTARY in registers_of_a_description(1, 0)
    assert to_registers(describe_mock(scene_of("linear")))[13] == 0


@pytest.mark.parametrize("motion", [("linear", "linear"), ("rotary", "rotary"), ("linear", "rotary")])
def test_a_board_that_declares_nothing_takes_every_scene(motion: tuple[str, ...]) -> None:
    require_compatible(scene_of(*motion), "port", described(0))


@pytest.mark.parametrize(
    ("motion", "rotary", "channel", "advice"),
    [
        (("linear", "linear"), 0b11, "channel 0 of the device is rotary", "Write motion: rotary under device"),
        (("linear", "linear"), 0b10, "channel 1 of the device is rotary", "Write motion: [linear, rotary] under"),
        (("rotary", "rotary"), 0b10, "channel 0 of the device is linear", "Write motion: [linear, rotary] under"),
        (("linear",), 0b01, "channel 0 of the device is rotary (its register 13), the scene has motion: linear", ""),
    ],
)
def test_a_board_of_another_motion_is_refused(motion: tuple[str, ...], rotary: int, channel: str, advice: str) -> None:
    with pytest.raises(UsageError) as refused:
        require_compatible(scene_of(*motion), "port", described(rotary))
    assert channel in str(refused.value)
    assert advice in str(refused.value)


def test_a_channel_that_the_scene_leaves_alone_may_be_of_any_motion() -> None:
    require_compatible(scene_of("rotary"), "port", described(0b01))
    require_compatible(scene_of("rotary"), "port", described(0b11))


def test_on_a_port_probe_shows_it_and_run_refuses_a_linear_scene(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "linear.yaml"
    path.write_text(yaml.safe_dump(scene_of("linear").model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    with serving(assemble_mock(scene_of("rotary"))) as port:
        probed = " ".join(hapsim("probe", port, "--until", "registers").out.split())
        refused = hapsim("run", path, "--port", port, "--duration", 0.05)
    assert "pass rotary (§ 5): 0x1: channel 0 rotary" in probed
    assert "pass position_scale (§ 5): 1e-06 rad per count" in probed
    assert "pass force_limit (§ 5): 10 N·m" in probed
    assert refused.status == 2
    assert "the scene has motion: linear there. Write motion: rotary under device" in " ".join(refused.err.split())
