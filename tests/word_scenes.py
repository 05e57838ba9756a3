"""Scenes with digital words."""

from __future__ import annotations

from hapsim.scene import Scene

WORDS = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.1, friction: 1, force_limit: 10}
inputs:
  touch: {bit: 0}
  grip: {bit: 31, inverted: true}
outputs:
  code: {bits: [8, 15]}
  led: {bit: 3}
  hit: {bit: 2, when: wall}
mock: {initial: {position: 0.01}, inputs: {touch: [0.5, 1200 ms]}}
modules:
  hand: {type: device, channel: 0}
  post: {type: ground, position: 0}
  wall: {type: buffer, between: [hand, post], stiffness: 100}
"""


def without_words(scene: Scene) -> Scene:
    return scene.changed({"mock.inputs": None}).model_copy(update={"inputs": {}, "outputs": {}})
