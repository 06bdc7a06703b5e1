"""Semantic classes of instances, by the names that files give them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.base.files import read_json
from solari_vk.scene import checks
from solari_vk.scene.model import Instance, Scene
from solari_vk.scene.objects import fits

Classes = Mapping[str, str | Mapping[str, str] | None] | str | PathLike[str]


class Class(NamedTuple):
    """What an instance is; part_of: None leaves it as it is."""

    label: str
    part_of: str | None = None


@checked_keywords(who="solari_vk")
def label_instances(scene: Scene, classes: Classes) -> None:
    """Assign `label` of the instances whose names, or objects' names (`Instance.part_of`), fit a pattern; others stay
    as they are.

    classes: the class for each pattern, such as {"Chair*": "chair"}, or a JSON file of them; None (null) takes a class
    away. `*` stands for any characters, `?` for one, `[ab]` for one of some; of several patterns that fit a name the
    first counts. The studio's floor has a label by its own name only. {"Car*": {"label": "car", "part_of": "car 1"}}
    makes all that fit parts of one object too. Raises SolariError for a file that isn't such an object, and for a
    pattern that fits no name.
    """
    for instance, found in find_labels(scene.instances[:], classes, scene.backdrop).items():
        instance.label = found.label
        if found.part_of is not None:
            instance.part_of = found.part_of


def find_labels(
    instances: Sequence[Instance], classes: Classes, floor: Instance | None = None
) -> dict[Instance, Class]:
    """What `label_instances` assigns to these instances; floor: the studio's."""
    who = "labels"
    mapping: Any = classes
    if isinstance(classes, str | PathLike):
        path = Path(classes)
        who = f"labels {path}"
        mapping = read_json(path, who)
    if not isinstance(mapping, Mapping):
        raise SolariError(f"{who}: {_FORM}, not {quoted(mapping)}")
    named = {pattern: _class(pattern, value, who) for pattern, value in mapping.items()}
    found: dict[Instance, Class] = {}
    unused = dict(named)
    for instance in instances:
        # In the order of the file: the first pattern counts.
        fitting = [pattern for pattern in named if fits(instance, pattern, floor)]
        for pattern in fitting:
            # Also of patterns that fit later than another: they aren't misspelt.
            unused.pop(pattern, None)
        if fitting:
            found[instance] = named[fitting[0]]
    if unused:
        names = sorted({instance.name for instance in instances if instance.name})
        raise SolariError(
            f"{who}: no instance is named {quoted(next(iter(unused)))}; names are "
            f"{', '.join(map(quoted, names[:8]))}{', ...' if len(names) > 8 else ''}"
        )
    return found


_FORM = 'give a class for each pattern of names, such as {"Chair*": "chair"}'


def _class(pattern: Any, value: Any, who: str) -> Class:
    words = value if isinstance(value, Mapping) else {"label": "" if value is None else value}
    if "label" not in words or not words.keys() <= set(Class._fields):
        raise SolariError(
            f'{who}: {quoted(pattern)}: give a class, or {{"label": "chair", "part_of": "chair 1"}}, not '
            f"{quoted(value)}"
        )
    if not all(isinstance(word, str) for word in (pattern, *words.values())):
        raise SolariError(f"{who}: {_FORM}, not {quoted(value)} for {quoted(pattern)}")
    try:
        return Class(**{name: checks.line(word) for name, word in words.items()})
    except ValueError as error:
        raise SolariError(f"{who}: a class {error}") from None
