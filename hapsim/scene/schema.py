"""The JSON schema of the scene file, for editors that complete and check YAML while it is typed."""

from typing import Any

from .scene import VERSION, Scene


def scene_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a scene file.

    It holds what one value by itself has to be, with units and defaults. What takes more than one value, such
    as a name that has to exist, only `parse_scene` checks.
    """
    described = Scene.model_json_schema() | {
        "title": f"hapsim scene, version {VERSION}",
        "description": "A scene for hapsim: the device that the hand holds, and what it feels. SI units.",
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_without_null(described)}


def _without_null(schema: Any) -> Any:
    """The schema of the file, which takes no ``null``: a None of Python is there a key that is left out."""
    if isinstance(schema, list):
        return [_without_null(entry) for entry in schema if entry != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(value) for key, value in schema.items() if (key, value) != ("default", None)}
    choices = kept.get("anyOf", ())
    if len(choices) != 1:
        return kept
    del kept["anyOf"]
    return choices[0] | kept
