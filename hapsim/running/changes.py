"""Changing a scene while it runs: what may change, and what is wrong with a change that may not.

Where nothing but live parameters differs they are led to their new values. Anything else in the list of modules makes
another program, compiled here beside the running loop, which takes over from the one before.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from hapsim.cordis.program import compile_scene, fixed_modules, parameter_values
from hapsim.cordis.schemes import without_matrices
from hapsim.cordis.succession import take_over_from
from hapsim.errors import UsageError
from hapsim.loop.realtime.giving_way import Beside
from hapsim.prediction import surely_shaken_by
from hapsim.prediction.correction import Rendering, rendered
from hapsim.running.assemble import Loop
from hapsim.running.stability import require_followable
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean, one_of
from hapsim.scene.modules import Module, ModuleContext
from hapsim.scene.part import Part, Table

OVER = "the run is over: nothing can be changed any more"

_EXAMPLE = '{"touch": {"stiffness": 500.0}}'
_LONGEST = 2.0**40  # samples
_GLANCE_S = 1e-3
_HOW_IT_BEGAN = ("mock", "initial")


class LiveScene:
    """The scene of a running loop. Any thread may change it, one after the other."""

    def __init__(
        self,
        scene: Scene,
        loop: Loop,
        is_over: Callable[[], bool] = lambda: False,
        gives_way: bool = False,
        unstable: bool | None = None,
    ) -> None:
        """`is_over`: whether the loop has ended, so that nobody has to be waited for any more. `gives_way`: whether
        what is prepared beside the loop gives way to it. `unstable`: as of `start`."""
        self.scene = scene
        """With every change that was posted."""
        self._loop, self._is_over, self._gives_way, self._unstable = loop, is_over, gives_way, unstable
        self._replacing, self._writing = threading.Lock(), threading.Lock()

    def set(self, changes: Mapping[str, Mapping[str, float]], over: float) -> None:
        """Changes some live parameters; UsageError, and nothing is changed, where a name, a key or a value is wrong."""
        if self._gives_way and self._unstable is not None:  # a prediction takes time, of a large scene seconds
            Beside(lambda: self._set(changes, over)).result()
        else:
            self._set(changes, over)

    def _set(self, changes: Mapping[str, Mapping[str, float]], over: float) -> None:
        with self._writing:
            scene = _changed(self.scene, changes)
            if self._unstable is False:
                require_followable(self.scene, scene)
            self._lead_to(scene, over)

    def adopt(self, scene: Scene, over: float) -> None:
        """Changes to `scene`, whatever its modules are; UsageError, and nothing is changed, where that cannot be."""
        samples = _samples(scene, over)
        if self._gives_way:
            Beside(lambda: self._adopt(scene, over, samples)).result()
        else:
            self._adopt(scene, over, samples)

    def _adopt(self, scene: Scene, over: float, samples: int) -> None:
        with self._replacing:
            self._require_possible(scene)
            if differs_in_live_parameters_alone(self.scene, scene):
                with self._writing:
                    self._lead_to(scene, over)
            elif scene != self.scene:
                self._replace(scene, samples)

    def _lead_to(self, scene: Scene, over: float) -> None:
        """Nothing is posted where nothing differs."""
        samples = _samples(scene, over)
        rendering = rendered(scene)
        values = parameter_values(rendering.scene)
        if not _same_values(values, parameter_values(self._run)):
            self._tell_guard(samples, self._is_judged_unstable(scene))
            self._loop.program.parameters.post(values, samples)
            self._correct_as(rendering, samples)
        self.scene, self._loop.run = scene, rendering.scene

    def _replace(self, scene: Scene, samples: int) -> None:
        """Live parameters may be set meanwhile; nobody but the last lines holds them up."""
        rendering = rendered(scene)
        run = rendering.scene
        program, is_unstable = compile_scene(run), self._is_judged_unstable(scene)
        while self._loop.is_replacing:
            if self._is_over():
                raise UsageError(OVER)
            time.sleep(_GLANCE_S)
        with self._writing:
            self._tell_guard(samples, is_unstable)
            take_over_from(self._loop.program, self._run, program, run)
            self._loop.account_for(program, run)
            program.parameters.post(parameter_values(run), samples)
            self._loop.follow_with(program, samples)
            self._correct_as(rendering, samples)
            self.scene, self._loop.run = scene, run

    @property
    def _run(self) -> Scene:
        """What is run in place of `scene`."""
        return self.scene if self._loop.run is None else self._loop.run

    def _tell_guard(self, samples: int, is_unstable: bool) -> None:
        """Before the change acts, which takes so many samples."""
        if self._loop.energy_guard is not None:
            self._loop.energy_guard.follow(unstable=is_unstable, samples=samples)

    def _is_judged_unstable(self, scene: Scene) -> bool:
        """Whether it is predicted unstable, where such a scene may run and its energy is judged."""
        return bool(self._unstable) and self._loop.energy_guard is not None and surely_shaken_by(scene) is not None

    def _correct_as(self, rendering: Rendering, samples: int) -> None:
        if self._loop.correction is not None:
            self._loop.correction.follow(rendering, samples)

    def _require_possible(self, scene: Scene) -> None:
        stays = what_stays(self.scene, scene)
        if stays:
            raise UsageError(f"{stays} cannot change while the scene runs: stop it and start it anew")
        io = self._loop.record.io
        if scene.channels > io.channels:
            raise UsageError(f"the device has {io.channels} channel(s), the scene uses {scene.channels}")
        if scene.sensed_links and not io.velocities:
            raise UsageError(
                f"{scene.sensed_links[0]}: damper: sensed needs the device's velocities, which it was not asked for "
                "when it was armed: stop the scene and start it anew, or write damper: backward"
            )
        if not self._unstable:
            require_followable(self.scene, scene)


def what_stays(now: Scene, wanted: Scene) -> str:
    """The first thing in which two scenes differ that stays as it is while one runs; empty where there is none."""
    if now.rate != wanted.rate:
        return "rate"
    for part in ("device", "mock"):
        before, after = getattr(now, part), getattr(wanted, part)
        if type(before) is not type(after):
            return part
        for key in type(before).model_fields if before is not None else ():
            if (part, key) != _HOW_IT_BEGAN and not _agree(getattr(before, key), getattr(after, key)):
                return f"{part}.{key}"
    return ""


def _agree(before: Any, after: Any) -> bool:
    """Whether two values of a device mean the same. Of lists, which have a value for each channel, and of one value for
    all, those channels count that both have."""
    if isinstance(before, Part) and type(before) is type(after):
        return all(_agree(getattr(before, key), getattr(after, key)) for key in type(before).model_fields)
    channels = [len(one) for one in (before, after) if isinstance(one, tuple | list)]
    if not channels:
        return bool(before == after)
    lists = [one if isinstance(one, tuple | list) else [one] * min(channels) for one in (before, after)]
    return all(one == other for one, other in zip(*lists, strict=False))


def differs_in_live_parameters_alone(now: Scene, wanted: Scene) -> bool:
    """Whether one becomes the other by nothing but parameters that may change while it runs."""
    if what_stays(now, wanted) or (now.precision, now.scheme) != (wanted.precision, wanted.scheme):
        return False
    fixed = fixed_modules(now)
    return list(now.modules) == list(wanted.modules) and all(
        before == after or (name not in fixed and type(before) is type(after) and _same_but_for_live(before, after))
        for (name, before), after in zip(now.modules.items(), wanted.modules.values(), strict=True)
    )


def _same_but_for_live(before: Module, after: Module) -> bool:
    keys = (key for key in type(before).model_fields if key not in before.live)
    return all(getattr(before, key) == getattr(after, key) for key in keys)


def _same_values(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return one.shape == other.shape and bool(np.array_equal(one, other))


def _samples(scene: Scene, over: float) -> int:
    """In how many samples a change is led to the hand, 1 or more."""
    sound = isinstance(over, int | float) and math.isfinite(over) and over >= 0
    samples = math.ceil(over * scene.rate) if sound else -1
    if not 0 <= samples <= _LONGEST:
        raise UsageError(f"over: found {over} s, expected the seconds in which the scene changes, 0 or more")
    return max(samples, 1)


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
                f"under scheme: {one_of(without_matrices())} it can"
            )
        modules[name] = _module_with(name, modules[name], values)
    around = ModuleContext(modules, {name: type(module) for name, module in modules.items()})
    for name in changes:
        for issue in modules[name].issues(name, around):
            raise UsageError(f"{name}.{issue.path[-1]}: {issue.sentence}")
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
