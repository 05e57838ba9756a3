"""Scene files -> `Scene`, or a `SceneError` that holds every fault of the file; and their JSON schema for editors."""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, BinaryIO

from pydantic import ValidationError

from hapsim.errors import SceneError, UsageError
from hapsim.units import LINEAR, MOTIONS, Units, Written, complete

from .cross_checks import cross_check_issues, motions_of, per_channel_paths
from .curve_file import CurveTable, insert_curves
from .issue import Issue, Path, quote
from .mock import Hand
from .modules import MODULE_TYPES
from .ranges import adapter_of, read_ranges, take_ranges, with_range
from .scene import VERSION, Origin, Scene
from .schemas import FROM_FILE
from .section import Module, ModuleContext
from .shipped import shipped_scene, shipped_scene_path, shipped_scenes
from .sound_channels import PickUp
from .written_units import UnitError, in_si, quantities_in, written_unit
from .yaml_document import Document
from .yaml_file import MOST_BYTES, Layout, YamlFile, findings_of

_FILE = YamlFile(
    SceneError, "a scene in YAML", "found nothing, expected a scene; `hapsim new` writes a first one", shipped_scenes
)
_LAYOUT = Layout(
    Scene,
    "modules",
    "type",
    MODULE_TYPES,
    "a mapping such as {type: mass, mass: 0.01}",
    {
        (): "a mapping with version, rate, device and modules",
        ("devices",): "a mapping from names to devices, such as left: {port: /dev/ttyACM0, mass: 0.2}",
        ("mocks",): "a mapping from names of devices to what their mocks do",
        ("modules",): "a mapping from names to modules",
        ("sound",): "a mapping from names to pick-ups",
        ("inputs",): "a mapping from names to inputs, such as touch: {bit: 0}",
        ("outputs",): "a mapping from names to outputs, such as led: {bit: 3}",
        ("device", "assumed_hand"): "a mapping such as {stiffness: 300, damping: 5}",
        ("device", "servo"): "a mapping such as {bandwidth: 50, damping: 1}",
    },
)

SceneSource = Scene | str | os.PathLike[str]
"""A scene, or the path of its file."""


def as_scene(source: SceneSource) -> Scene:
    """Returns a scene as it is, and loads that of a path. Raises SceneError as `load_scene`, and UsageError
    for what is neither."""
    if not isinstance(source, Scene | str | bytes | os.PathLike):
        raise UsageError(f"found {quote(repr(source))[1:-1]}, expected a Scene, or the path of a scene's file")
    return source if isinstance(source, Scene) else load_scene(source)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a file; if there is none, the shipped scene of this name, without a `path`. Raises SceneError: the
    file cannot be read or is not a scene; one line for each fault, in the file's order."""
    name = os.fsdecode(path)
    if not os.path.exists(name) and (shipped := shipped_scene_path(name)):
        return parse_scene(shipped_scene(name), str(shipped), os.path.dirname(shipped))
    scene = parse_scene(_FILE.text_of(name), name, os.path.dirname(name))
    scene._path = name
    return scene


def parse_scene(text: str, name: str = "<scene>", folder: str | None = None) -> Scene:
    """The scene of a text in YAML.

    Args:
        text: the YAML.
        name: what errors call it.
        folder: of the files that it names, such as a curve's; by default it may name none.

    Raises:
        SceneError: the text is not a scene; one line for each fault, in the text's order.
    """
    document = _FILE.document_of(text, name)
    ranged = take_ranges(document.data)
    document.ranged = {path for path, (_, mapping) in ranged.items() if "value" in mapping}
    curves = insert_curves(document.data, folder)
    scene, issues = _validate(document, curves.tables, ranged)
    faults = _FILE.located([*curves.issues, *issues], document)
    files = tuple(dict.fromkeys(curves.files))
    if scene is None or faults:
        failure = _FILE.failure(name, faults)
        failure.files = files  # type: ignore[attr-defined]
        raise failure
    scene._files, scene._origin = files, Origin(text, folder, scene)
    return scene


def scene_from_document(data: dict[str, Any], origin: Scene) -> Scene:
    """The scene of a document that `Scene.document` made of `origin` and others changed, where numbers may have units;
    it has the units and the ranges of `origin`. SceneError, with each fault by its path as in sweeps, where it is
    none."""
    try:
        scene = Scene.model_validate(data)
    except ValidationError:
        found, issues = _validate(_FILE.document_of(json.dumps(data, default=str), "the scene"))
        if found is None or issues:
            raise SceneError("; ".join(f"{_path_of(one)}: {one.sentence}" for one in issues)) from None
        scene = found
    scene._written, scene._ranges = origin._written, origin._ranges
    return scene


def _path_of(issue: Issue) -> str:
    """Returns the path of a fault, such as "touch.stiffness"."""
    return ".".join(map(str, issue.path[1:] if issue.path[:1] in (("modules",), ("sound",)) else issue.path))


def recorded_scene(document: dict[str, Any], name: str, written: Iterable[Iterable[Any]] = ()) -> Scene:
    """The scene of a record's document, as `Scene.ranged_document` has it. Raises SceneError as `parse_scene`.

    Args:
        document, name: the document, and what errors call it.
        written: the report's, of the units of the scene's file.
    """
    scene = parse_scene(json.dumps(document), name)
    scene._written = tuple(Written(*one) for one in written)
    return scene


def _devices_of(data: dict[str, Any]) -> dict[str | None, Any]:
    """Returns a file's devices by name; one without a name by None."""
    devices: Any = data.get("devices")
    return devices if isinstance(devices, dict) and devices else {None: data.get("device")}


def _units_by_path(data: dict[str, Any], modules: ModuleContext, written: Iterable[Written]) -> Callable[[Path], Units]:
    """Returns a function of a path: the units of the module or channel there; of the whole scene if that is unknown.
    `written`: the units of the file."""
    stated = {
        name: one.get("motion", "linear") if isinstance(one, dict) else None for name, one in _devices_of(data).items()
    }
    whole = Units.parse([*stated.values()])
    of_module = motions_of(modules, stated.get(None, stated))

    def units_at(path: Path) -> Units:
        """Returns the units of the value at a path of the file."""
        own: object = None
        if path[:1] == ("modules",):
            own = of_module.get(str(path[1])) if path[1:] else None
        else:
            name = None if None in stated else next(iter(path[1:2]), None)
            inner, motion = path[1:] if name is None else path[2:], stated.get(name)  # type: ignore[arg-type]
            by_channel = motion if isinstance(motion, list) else []
            own = motion if name is not None and not by_channel else None
            if inner[:1] != ("travel",) or len(inner) > 2:  # not within a single pair
                steps = (step for step in inner if isinstance(step, int))
                own = next((one for step in steps for one in by_channel[step : step + 1]), own)
        return Units.of([own] if own in MOTIONS else whole.motions, written)

    return units_at


def fields_at(scene: Scene, document: dict[str, Any]) -> Callable[[Path], tuple[str, Units]]:
    """Returns a function of a path in a document of `scene`: the unit of its field, as for linear motion, and the units
    of its module or channel."""
    units_at = _units_by_path(document, ModuleContext.of(scene.modules), scene.written)
    return lambda path: (_LAYOUT.unit(path, document), units_at(path))


def text_of(path: str | os.PathLike[str]) -> str:
    """The text of a scene's file. Raises SceneError where it cannot be read."""
    return _FILE.text_of(path)


def read_scene(stream: BinaryIO, name: str) -> Scene:
    """The scene of a stream of bytes, which errors call `name`. Raises SceneError as `load_scene`."""
    return parse_scene(_FILE.decoded(stream.read(MOST_BYTES + 1), name), name, "")


def _validate(
    document: Document, curves: Mapping[Path, CurveTable] = {}, ranged: Mapping[Path, Any] = {}
) -> tuple[Scene | None, list[Issue]]:
    """The scene of a document and nothing, or no scene and what is wrong with it. `curves`, `ranged`: curves in files
    and mappings with ranges, by path."""
    try:
        data: Any = document.data
        scene = Scene.model_validate(data, context=FROM_FILE)
        modules = ModuleContext.of(scene.modules)
        scene._written, issues = _units_of(data, modules, curves, ranged)
        scene._ranges, faults = read_ranges(ranged, document, _units_by_path(data, modules, scene._written))
        return scene, _merged(faults, issues)
    except ValidationError as error:
        data = document.data if isinstance(document.data, dict) else {}
        modules = _sound_modules(data.get("modules"))
        written, misplaced = _units_of(data, modules, curves, ranged)
        units_at = _units_by_path(data, modules, written)
        _, faults = read_ranges(ranged, document, units_at)
        issues = _merged(faults, findings_of(error, document, _LAYOUT, units_at))
        if type(data.get("version")) is int and data["version"] != VERSION:
            # Another format: what else seems wrong may be right in it.
            return None, [issue for issue in issues if issue.path == ("version",)]
        # The checks across parts reach as far as the sound parts of the scene allow.
        across = cross_check_issues(modules, _sound_fields(data, issues), data)
        filled = (replace(one, sentence=units_at(one.path).filled(one.sentence)) for one in across)
        return None, [*_merged(issues, misplaced), *filled]


def _merged(issues: list[Issue], others: Iterable[Issue]) -> list[Issue]:
    """Returns the issues, and of the others those at further paths."""
    known = {issue.path for issue in issues}
    return [*issues, *(one for one in others if one.path not in known)]


def _units_of(
    data: dict[str, Any], modules: ModuleContext, curves: Mapping[Path, CurveTable], ranged: Mapping[Path, Any]
) -> tuple[tuple[Written, ...], list[Issue]]:
    """Returns the units that a file writes, and its quantities whose unit fits their field, but not the motion of their
    module or channel."""
    found, written, issues = [*quantities_in(data)], [], []
    for at, (_, mapping) in ranged.items():
        found += [((*at, "range", *inner), text) for inner, text in quantities_in(mapping.get("range"))]
    units_at = _units_by_path(data, modules, ()) if found or curves else lambda _: LINEAR
    for path, text in found:
        unit, units = _LAYOUT.unit(path, data), units_at(path)
        try:
            if unit and units.motions:
                in_si(text, unit, units.motions)
                written += [one for motion in units.motions if (one := written_unit(text, unit, motion))]
        except UnitError as error:
            remedy = "" if units.is_rotary else ", or device.motion: rotary"
            issues.append(Issue(path, f"found {error.found}, expected {units.filled(error.expected(unit))}{remedy}"))
    for path, table in curves.items():
        units = units_at(path)
        if table.motion in units.motions:
            written += table.written
        elif units.motions:
            names = f"{table.unit('m').unit} and {table.unit('N').unit}"
            expected = units.filled("‹one m›, and ‹one N›")
            issues.append(Issue(path, f"{table.name}:{table.head}: found {names}, expected {expected}"))
    return complete(written), issues


def _sound_modules(modules: object) -> ModuleContext:
    """Returns the context of the modules that are valid while others are faulty."""
    if not isinstance(modules, dict):
        return ModuleContext({}, {"": None})
    types = {name: module.get("type") if isinstance(module, dict) else None for name, module in modules.items()}
    kinds = {name: MODULE_TYPES.get(kind) if isinstance(kind, str) else None for name, kind in types.items()}
    both = {name: _sound_part(kind, modules[name]) for name, kind in kinds.items() if kind is not None}
    faulty = {name: wrong for name, (_, wrong) in both.items() if wrong}
    return ModuleContext({name: module for name, (module, _) in both.items()}, kinds, faulty)


def _sound_part(kind: type[Module], data: Any) -> tuple[Module, frozenset[str]]:
    """The module with its sound fields, and the names of the others."""
    try:
        return kind.model_validate(data, context=FROM_FILE), frozenset()
    except ValidationError as error:
        faulty = frozenset(str(detail["loc"][0]) for detail in error.errors(include_url=False))
        sound = [field for field in kind.model_fields if field in data and field not in faulty]
        values = {field: adapter_of(kind, field).validate_python(data[field], context=FROM_FILE) for field in sound}
        return kind.model_construct(None, **values), faulty


def _sound_fields(data: dict[str, Any], issues: Iterable[Issue]) -> dict[Path, dict[str, object]]:
    """The fields of the device and the mock in which no fault was found."""
    faulty = {issue.path[:length] for issue in issues for length in range(len(issue.path) + 1)}
    sound: dict[Path, dict[str, object]] = {}
    for path in per_channel_paths(data):
        part: Any = data
        for step in path:
            part = part.get(step) if isinstance(part, dict) else None
        fields = part if isinstance(part, dict) else {}
        sound[path] = {name: value for name, value in fields.items() if (*path, name) not in faulty}
    return sound


def scene_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scene file: its values one by one, with units and defaults. Only `parse_scene`
    checks values together, such as a name that has to exist."""
    about = "A scene for hapsim: the device that the hand holds, and what it feels. SI units, or numbers with units."
    described = Scene.model_json_schema() | {
        "title": f"hapsim scene, version {VERSION}",
        "description": about,
    }
    kinds: tuple[Any, ...] = (*MODULE_TYPES.values(), PickUp, Hand)
    for kind in kinds:
        fields = described["$defs"][kind.__name__]["properties"]
        fields |= {key: with_range(fields[key]) for key in kind.live}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_without_null(described)}


def _without_null(schema: Any) -> Any:
    """The schema of the file, which takes no ``null``: where Python has None, the file omits the key."""
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
