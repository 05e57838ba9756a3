"""YAML text -> plain values that know where they stand in the file.

The text is composed to YAML nodes and these are read here, rather than by PyYAML's constructor: that one
keeps no positions, and lets the last of two equal keys win without a word.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import yaml

from .issue import LocatedIssue, Path, Place, quote
from .syntax import place_of
from .yaml_rules import (
    MAPPING,
    MERGE,
    MOST_NESTING,
    NO_COMMA,
    SEQUENCE,
    STRING,
    TOO_DEEP,
    describe,
    is_behind_comma,
    number_hint,
    scalar_value,
    short_tag,
)

Entries = dict[str, tuple[yaml.Node, yaml.Node]]


#: What stands under a key with nothing behind it, or ``null``: a value that no field takes. None would do for a field
#: that may be left out, and an emptied limit would be the default without a word. (pydantic looks for the fields of a
#: part in an object of any class but the built-in ones.)
NOTHING = ...


class Document:
    """The values of a YAML text, and the position of each.

    Attributes:
        data: the values as dicts, lists, str, float, int and bool, `NOTHING` under a key without a value; what is
            faulty is left out or is nothing.
        faults: what is wrong already on this level, such as a key that stands twice.
    """

    def __init__(self, root: yaml.Node) -> None:
        self._root = root
        self._values: dict[int, object] = {}
        self._entries: dict[int, Entries] = {}
        self._open: list[int] = []
        self.faults: list[LocatedIssue] = []
        self.data = self._value(root)

    def place(self, path: Path, at_key: bool = False) -> Place:
        """Where the value at ``path`` stands, or its key; of a path that breaks off, its last step."""
        key, value = self._nodes(path)
        return place_of(key if at_key else value)

    def found(self, path: Path) -> str:
        """The value at ``path`` in words, as the file spells it."""
        return describe(self._nodes(path)[1])

    def value(self, path: Path) -> object:
        """The value at ``path``."""
        return self._values.get(id(self._nodes(path)[1]))

    def keys(self, path: Path) -> list[str]:
        """The keys of the mapping at ``path``."""
        return list(self._entries.get(id(self._nodes(path)[1]), ()))

    def number_hint(self, path: Path) -> str:
        """What to do about the value at ``path`` if it is a text and a number is meant."""
        return number_hint(self._nodes(path)[1])

    def _nodes(self, path: Path) -> tuple[yaml.Node, yaml.Node]:
        key = node = self._root
        for step in path:
            entries = self._entries.get(id(node))
            if entries is not None and isinstance(step, str) and step in entries:
                key, node = entries[step]
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
                key = node = node.value[step]
            else:
                break
        return key, node

    def _value(self, node: yaml.Node) -> object:
        if id(node) not in self._values:
            with self._opened(node) as allowed:
                self._values[id(node)] = self._read(node) if allowed else None
        return self._values[id(node)]

    def _read(self, node: yaml.Node) -> object:
        if not isinstance(node, yaml.ScalarNode) and node.tag not in (MAPPING, SEQUENCE):
            self._fault(node, f"found the tag {short_tag(node.tag)}, expected a plain value without a tag")
        if isinstance(node, yaml.MappingNode):
            values = {name: self._value(value) for name, (_, value) in self._entries_of(node).items()}
            return {name: NOTHING if value is None else value for name, value in values.items()}
        if isinstance(node, yaml.SequenceNode):
            return [self._value(entry) for entry in node.value]
        try:
            return scalar_value(node)
        except ValueError as error:
            self._fault(node, str(error))
            return None

    def _entries_of(self, node: yaml.MappingNode) -> Entries:
        """The mapping's own entries, then those that it merges from elsewhere."""
        if id(node) not in self._entries:
            own: Entries = {}
            merged: Entries = {}
            for key, value in self._whole_entries(node):
                if key.tag == MERGE:
                    merged = {**self._merged(value), **merged}
                else:
                    self._add(own, key, value)
            self._entries[id(node)] = own | {name: pair for name, pair in merged.items() if name not in own}
        return self._entries[id(node)]

    def _whole_entries(self, node: yaml.MappingNode) -> Iterator[tuple[yaml.Node, yaml.Node]]:
        """Those that no comma cut off a number: ``{stiffness: 2,000}`` has a key ``000``, which nobody wrote."""
        number: yaml.Node | None = None
        before: yaml.Node | None = None
        for key, value in node.value:
            if before is None or not is_behind_comma(before, key, value):
                yield key, value
                number = before = value
                continue
            if number is not None and before is number:  # and not the second comma of 1,000,000
                self._fault(number, f"found {quote(f'{number.value},{key.value}')}, {NO_COMMA}")
            before = key

    def _add(self, own: Entries, key: yaml.Node, value: yaml.Node) -> None:
        if not isinstance(key, yaml.ScalarNode) or key.tag != STRING:
            self._fault(key, f"found {describe(key)} as a key, expected a name")
        elif key.value in own:
            first = place_of(own[key.value][0]).line
            self._fault(key, f"found the key {quote(key.value)} again, expected it once: it stands in line {first}")
        else:
            own[key.value] = (key, value)

    def _merged(self, node: yaml.Node) -> Entries:
        """What ``<<`` brings in: one mapping, or a list of them, of which the first counts most."""
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        merged: Entries = {}
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                self._fault(source, f"<<: found {describe(source)}, expected a mapping to take keys from")
                continue
            with self._opened(source) as allowed:
                if allowed:
                    merged = {**self._entries_of(source), **merged}
        return merged

    @contextmanager
    def _opened(self, node: yaml.Node) -> Iterator[bool]:
        """Keep count of the nodes around a node, so that nothing runs in a circle or too deep."""
        allowed = False
        if id(node) in self._open:
            self._fault(node, f"found {describe(node)} that contains itself, expected an end to it")
        elif len(self._open) > MOST_NESTING:
            self._fault(node, TOO_DEEP)
        else:
            allowed = True
        self._open.append(id(node))
        yield allowed
        self._open.pop()

    def _fault(self, node: yaml.Node, sentence: str) -> None:
        self.faults.append(LocatedIssue(place_of(node), sentence))
