"""YAML with one meaning: a key stands once in a mapping, and each value is of the kind that it seems to be."""

from __future__ import annotations

from typing import Any

import yaml

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, quoted

MOST_VALUES = 100_000  # where an alias stands, those of what it names count again
LONGEST_VALUE = 4096
_BYTES_PER_BYTE = 400  # of a text, while it is read


def read_yaml(text: str, who: str) -> Any:
    """The values of a text. Raises SolariError with the line for what isn't YAML, for a key that is there twice, and
    for what is too large."""
    charge(0, who, "its values", working=_BYTES_PER_BYTE * len(text))
    # PyYAML is written in Python and recurses: a file of ten thousand brackets ends in RecursionError.
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError) as error:
        # Its messages span lines, and call a text "<unicode string>".
        said = " ".join(str(error).replace(' in "<unicode string>"', "").split())
        raise SolariError(f"{who}: isn't YAML: {said}") from None


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """The safe loader makes plain values only, and no objects of classes that a file names."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._counts: dict[int, int] = {}  # of the values in a node, by its identity

    # An alias takes a few bytes and means all that it names, and aliases may be in what they name.
    def compose_node(self, parent: Any, index: Any) -> Any:
        is_alias = self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        if is_alias:
            if id(node) not in self._counts:
                self._refuse("an alias stands in what it names", node)
            return node
        parts = node.value
        if isinstance(node, yaml.ScalarNode):
            parts = ()
            if len(node.value) > LONGEST_VALUE:
                self._refuse(f"a value has more than {LONGEST_VALUE} characters", node)
        elif isinstance(node, yaml.MappingNode):
            parts = [part for pair in node.value for part in pair]
        self._counts[id(node)] = 1 + sum(self._counts[id(part)] for part in parts)
        # Without aliases the values so far tell, before the rest is read.
        if max(self._counts[id(node)], len(self._counts)) > MOST_VALUES:
            self._refuse(f"there are more than {MOST_VALUES:,} values, those that aliases stand for included", node)
        return node

    @staticmethod
    def _refuse(problem: str, node: Any) -> None:
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)

    # The YAML specification forbids equal keys; PyYAML takes the last one without a word.
    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        seen = set[tuple[str, str]]()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                self._refuse("a key is a list or a mapping", key)
            name = key.tag, str(key.value)
            if name in seen:
                self._refuse(f"the key {quoted(key.value)} is there twice", key)
            seen.add(name)
        return node

    # YAML 1.1 takes 2001-99-99 for a date and 0o for a number. PyYAML lets Python's own errors through for those that
    # there aren't, which name no line.
    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, LookupError, AttributeError) as error:
            kind = node.tag.rpartition(":")[2]
            raise yaml.MarkedYAMLError(
                problem=f"{quoted(node.value)} isn't of the kind {kind}: {error}", problem_mark=node.start_mark
            ) from None
