"""Whatever stands in a file, the answer is a scene or a `SceneError`, and every fault has a place."""

import re
from typing import Any

import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hapsim.errors import SceneError
from hapsim.scene import Scene, parse_scene
from tests import thorough

EXAMPLES = thorough.points(60, 120)

TEXT = """\
version: 1
rate: 1000
device: {port: /dev/ttyACM0, baud: 9600, clock: host, mass: [0.2, 0.1], friction: 1.0, delay: 1, hold: zoh}
mock: &m {mass: 0.3, initial: {position: [0, 0.1], velocity: 0.1}, quantum: 1.0e-9, noise: 0.0, seed: 3}
modules:
  hand:  {type: device, channel: 0}
  other: {type: device, channel: 1}
  wall:  {type: ground, position: 0.0}
  m1:    {type: mass, mass: 0.01, velocity: 2.5}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 2}
  more:  {type: viscoelastic, between: [other, m1], stiffness: 1e3}
  c:     {type: cell, mass: 0.01, stiffness: 100, position: 0.1}
  s:     {type: spring, between: [hand, c], stiffness: 10}
  d:     {type: damper, between: [other, c], damping: 1}
  n:     {type: nonlinear, between: [hand, wall], force_over_distance: [[-0.1, -5], [0, 0], [0.1, 20]]}
  rub:   {type: friction, between: [hand, wall], force: 1, static: 2, stiffness: 3000}
  pick:  {type: plectrum, between: [hand, m1], stiffness: 500, release: 0.002}
  row: {type: string, masses: 9, mass: 0.1, stiffness: 100, ends: [fixed, clamped], pluck: {at: 3, by: 0.01}}
  skin: {type: membrane, rows: 3, columns: 4, mass: 0.1, stiffness: 100, edges: [fixed, free, free, free]}
  grip: {type: viscoelastic, between: [row.8, skin.2.3], stiffness: 10}
"""

SCRAPS = st.sampled_from(
    [*":,[]{}&*!|>'\"%@`#-?~\t\n\\ ", "<<: *m", "*m", "&m ", "- ", ": ", "\n  ", "!!", "1e400", ".nan", "yes", "\\U"]
)
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(min_value=10**300, max_value=10**320),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(
        ["device", "ground", "viscoelastic", "nonlinear", "friction", "hand", "touch", "zoh", "[key]", "type"]
    ),
    st.lists(st.one_of(st.floats(), st.text(max_size=3), st.lists(st.none(), max_size=1)), max_size=3),
    st.dictionaries(st.one_of(st.text(max_size=3), st.integers(), st.none()), st.integers(), max_size=2),
)
KEYS = st.one_of(
    st.sampled_from(
        ["type", "mass", "channel", "between", "device", "modules", "[key]", "", "touch", "initial", "pluck", "masses"]
    ),
    st.integers(),
    st.booleans(),
    st.text(max_size=3),
)


def scene_or_faults(text: str) -> Scene | None:
    try:
        return parse_scene(text, "x")
    except SceneError as error:
        for line in str(error).splitlines():
            place = re.match(r"x:(\d+):(\d+): \S", line)
            assert place, line
            assert 1 <= int(place[1]) <= len(re.split("\r\n|[\r\n\x85\u2028\u2029]", text)) + 1
            assert not re.search(r"pydantic|Input should|https?:|Traceback", line), line
        return None


@given(st.text(max_size=200))
@settings(max_examples=EXAMPLES, deadline=None)
def test_random_text_is_a_scene_or_a_scene_error(text: str) -> None:
    scene_or_faults(text)


@given(st.lists(st.one_of(SCRAPS, st.sampled_from(TEXT.split(" "))), max_size=40))
@settings(max_examples=EXAMPLES, deadline=None)
def test_a_heap_of_pieces_of_a_scene_is_a_scene_or_a_scene_error(pieces: list[str]) -> None:
    scene_or_faults(" ".join(pieces))


@given(st.lists(st.tuples(st.integers(0, len(TEXT)), st.integers(0, 12), SCRAPS), min_size=1, max_size=4))
@settings(max_examples=EXAMPLES, deadline=None)
def test_a_scene_with_scraps_in_it_is_a_scene_or_a_scene_error(cuts: list[tuple[int, int, str]]) -> None:
    text = TEXT
    for start, length, scrap in cuts:
        text = text[:start] + scrap + text[start + length :]
    scene_or_faults(text)


@given(st.data())
@settings(max_examples=EXAMPLES, deadline=None)
def test_a_scene_with_other_values_and_keys_is_a_scene_or_a_scene_error(data: st.DataObject) -> None:
    tree = yaml.safe_load(TEXT)
    for _ in range(data.draw(st.integers(1, 3))):
        node: Any = tree
        while isinstance(node, dict | list) and node:
            step = data.draw(st.sampled_from(list(node) if isinstance(node, dict) else list(range(len(node)))))
            if not isinstance(node[step], dict | list) or data.draw(st.booleans()):
                node[step] = data.draw(VALUES)
                if isinstance(node, dict) and data.draw(st.booleans()):
                    node[data.draw(KEYS)] = node.pop(step)
                break
            node = node[step]
    scene_or_faults(yaml.safe_dump(tree, sort_keys=False, allow_unicode=True))


def test_the_scene_that_is_mutated_is_a_good_one() -> None:
    assert scene_or_faults(TEXT)
