"""YAML with one meaning: a key stands once in a mapping, and each value is of the kind that it seems to be."""

from __future__ import annotations

from typing import Any

import yaml

from solari_vk.base.errors import SolariError, quoted


def read_yaml(text: str, who: str) -> Any:
    """The values of a text. Raises SolariError with the line for what isn't YAML, and for a key that is there twice."""
    # PyYAML is written in Python and recurses: a file of ten thousand brackets ends in RecursionError.
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError) as error:
        # Its messages span lines, and call a text "<unicode string>".
        said = " ".join(str(error).replace(' in "<unicode string>"', "").split())
        raise SolariError(f"{who}: isn't YAML: {said}") from None


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """The safe loader makes plain values only, and no objects of classes that a file names."""

    # The YAML specification forbids equal keys; PyYAML takes the last one without a word.
    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        seen = set[tuple[str, str]]()
        for key, _ in node.value:
            name = key.tag, str(key.value)
            if name in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"the key {quoted(key.value)} is there twice", problem_mark=key.start_mark
                )
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
