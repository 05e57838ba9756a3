"""The JSON schema for editors agrees with what the loader takes and refuses."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from hapsim.scene import load_scene, scene_schema
from hapsim.scene.modules import MODULE_TYPES

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return scene_schema()


def error_paths(schema: dict[str, Any], text: str) -> list[str]:
    errors = Draft202012Validator(schema).iter_errors(yaml.safe_load(text))
    return [error.json_path for error in errors]


def test_the_schema_is_one_of_draft_2020_12(schema: dict[str, Any]) -> None:
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_schema_takes_what_ships(schema: dict[str, Any], path: Path) -> None:
    load_scene(path)
    assert error_paths(schema, path.read_text()) == []


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("version: 1", "version: 2", "$.version"),
        ("rate: 1000", "rate: 0", "$.rate"),
        ("rate: 1000", "rate: true", "$.rate"),
        ("rate: 1000\n", "", "$"),
        ("rate: 1000", "rate: 1000\nspeed: 1", "$"),
        ("{mass: 0.2}", "{mass: [0.2, -1]}", "$.device.mass"),
        ("{mass: 0.2}", "{mass: {value: 0.2}}", "$.device.mass"),
        ("{mass: 0.2}", "{mass: [{value: 0.2, uncertainty: 0}]}", "$.device.mass"),
        ("{mass: 0.2}", "{mass: 1, hold: level}", "$.device.hold"),
        ("{mass: 0.2}", "{mass: 1, delay: 1001}", "$.device.delay"),
        ("{mass: 0.2}", "{mass: 1, slew_limit: }", "$.device.slew_limit"),
        ("{mass: 0.2}", "{mass: 1, port: }", "$.device.port"),
        ("{mass: 0.2}", "{mass: 1, port: ''}", "$.device.port"),
        ("rate: 1000", "rate: 1000\nmock:", "$.mock"),
        ("rate: 1000", "rate: 1000\nmock: {mass: ~}", "$.mock.mass"),
        ("wall: ", "2nd: ", "$.modules"),
        ("type: ground", "type: floor", "$.modules.wall"),
        ("type: ground", "position: 0.0", "$.modules.wall"),
        ("type: ground", "type: ground, mass: 1", "$.modules.wall"),
        ("[hand, wall]", "[hand]", "$.modules.touch"),
        ("stiffness: 2000", "stiffness: -1", "$.modules.touch"),
    ],
)
def test_the_schema_refuses_what_the_loader_refuses(
    schema: dict[str, Any], good: str, old: str, new: str, where: str
) -> None:
    assert error_paths(schema, good) == []
    assert error_paths(schema, good.replace(old, new)) == [where]


def test_every_key_has_a_title_and_a_description_and_every_number_its_unit(schema: dict[str, Any]) -> None:
    parts = {"Scene": schema, **schema["$defs"]}
    assert {"Device", "Mock", "Initial", *(kind.__name__ for kind in MODULE_TYPES.values())} < set(parts)
    for part in parts.values():
        assert part["additionalProperties"] is False
        assert part["description"]
        for name, field in part["properties"].items():
            assert field["description"], name
            assert field.get("title") or "$ref" in field or name in ("device", "mock"), name
            if "number" in str(field):
                assert ", in " in field["description"], name


def test_the_defaults_of_the_format_are_in_the_schema(schema: dict[str, Any]) -> None:
    device = schema["$defs"]["Device"]["properties"]
    defaults = {name: field["default"] for name, field in device.items() if "default" in field}
    assert defaults == {
        "baud": 2_000_000,
        "clock": "device",
        "motion": "linear",
        "mode": "impedance",
        "simulated_damping": 0.0,
        "friction": 0.0,
        "stiffness": 0.0,
        "motor_lag": 0.0,
        "delay": 1.0,
        "hold": "zoh",
        "sampling": "ideal",
        "law": "host",
        "board_rate": 10_000.0,
        "board_delay": 1,
        "force_limit": 10.0,
        "sensors": [],
        "acceleration_age": 0,
        "correction": "none",
        "decimation": "last",
    }


def test_the_type_names_the_module_that_is_meant(schema: dict[str, Any]) -> None:
    (modules,) = schema["properties"]["modules"]["patternProperties"].values()
    assert set(modules["discriminator"]["mapping"]) == set(MODULE_TYPES)
    for kind in MODULE_TYPES.values():
        assert "type" in schema["$defs"][kind.__name__]["required"]
