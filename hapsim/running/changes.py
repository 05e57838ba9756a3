"""Changing a scene while it runs: what may change, and what is wrong with a change that may not."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping

from pydantic import ValidationError

from hapsim.cordis.program import fixed_modules, parameter_values
from hapsim.errors import UsageError
from hapsim.loop.parameters import Parameters, post
from hapsim.scene import Scene
from hapsim.scene.finding import did_you_mean
from hapsim.scene.modules import Module, Surroundings
from hapsim.scene.table import Table

_EXAMPLE = '{"touch": {"stiffness": 500.0}}'
_LONGEST = 2.0**40  # samples


class LiveParameters:
    """The parameters of a running loop. Any thread may change them."""

    def __init__(self, scene: Scene, parameters: Parameters) -> None:
        self.scene = scene
        """The scene with every change that was posted."""
        self._parameters = parameters
        self._writing = threading.Lock()

    def set(self, changes: Mapping[str, Mapping[str, float]], over: float) -> None:
        """Changes some of them; UsageError, and nothing is changed, where a name, a key or a value is wrong."""
        with self._writing:
            self._post(_changed(self.scene, changes), over)

    def adopt(self, scene: Scene, over: float) -> None:
        """Changes all of them to those of `scene`; UsageError where it differs in something else."""
        with self._writing:
            other = what_cannot_change(self.scene, scene)
            if other:
                raise UsageError(f"{other} cannot change while the scene runs: stop it and start it anew")
            self._post(scene, over)

    def _post(self, scene: Scene, over: float) -> None:
        sound = isinstance(over, int | float) and math.isfinite(over) and over >= 0
        samples = math.ceil(over * scene.rate) if sound else -1
        if not 0 <= samples <= _LONGEST:
            raise UsageError(f"over: found {over} s, expected the seconds in which the parameters change, 0 or more")
        post(self._parameters, parameter_values(scene), max(samples, 1))
        self.scene = scene


def what_cannot_change(now: Scene, wanted: Scene) -> str:
    """Names the first thing in which two scenes differ that cannot change while one runs; empty where there is none."""
    for key in ("rate", "precision", "scheme"):
        if getattr(now, key) != getattr(wanted, key):
            return key
    for part in ("device", "mock"):
        before, after = getattr(now, part), getattr(wanted, part)
        if type(before) is not type(after):
            return part
        for key in type(before).model_fields if before is not None else ():
            if getattr(before, key) != getattr(after, key):
                return f"{part}.{key}"
    if list(now.modules) != list(wanted.modules):
        others = sorted(set(now.modules) ^ set(wanted.modules))
        return f"the list of modules ({', '.join(others)})" if others else "the order of the modules"
    fixed = fixed_modules(now)
    for name, module in now.modules.items():
        odd = _what_cannot_change_of(module, wanted.modules[name])
        if odd:
            return f"{odd} of {name}"
        if name in fixed and module != wanted.modules[name]:
            return f"{name}, which {_in_a_matrix(now)},"
    return ""


def _what_cannot_change_of(now: Module, wanted: Module) -> str:
    if type(now) is not type(wanted):
        return "the type"
    keys = (key for key in type(now).model_fields if key not in now.live)
    return next((key for key in keys if getattr(now, key) != getattr(wanted, key)), "")


def _changed(scene: Scene, changes: Mapping[str, Mapping[str, float]]) -> Scene:
    """The scene with some values changed, checked as a scene file's values are."""
    modules: dict[str, Module] = dict(scene.modules)
    if not isinstance(changes, Mapping) or not all(isinstance(values, Mapping) for values in changes.values()):
        raise UsageError(f"found {changes!r}, expected the names of modules, each with what changes: {_EXAMPLE}")
    fixed = fixed_modules(scene)
    for name, values in changes.items():
        if name not in modules:
            raise UsageError(f"found '{name}', expected the name of a module{did_you_mean(str(name), modules)}")
        if name in fixed and modules[name].live:
            raise UsageError(
                f"{name}: nothing of it can change while the scene runs, because it {_in_a_matrix(scene)}; "
                "under scheme: cordis, semi_implicit or rk4 it can"
            )
        modules[name] = _module_with(name, modules[name], values)
    around = Surroundings(modules, {name: type(module) for name, module in modules.items()})
    for name in changes:
        for finding in modules[name].findings(name, around):
            raise UsageError(f"{name}.{finding.path[-1]}: {finding.sentence}")
    return scene.model_copy(update={"modules": Table(modules)})


def _in_a_matrix(scene: Scene) -> str:
    return f"is in the matrix that scheme: {scene.scheme} makes once"


def _module_with(name: str, module: Module, values: Mapping[str, float]) -> Module:
    for key in values:
        if key not in module.live:
            live = f"{' and '.join(module.live)} can" if module.live else "nothing can"
            raise UsageError(f"{name}: found '{key}', but of a {module.type} {live} change while the scene runs")
    try:
        return type(module).model_validate(module.model_dump() | dict(values))
    except ValidationError as error:
        fault = error.errors()[0]
        raise UsageError(f"{name}.{fault['loc'][0]}: found {fault['input']!r}, {fault['msg']}") from None
