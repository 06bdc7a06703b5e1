"""Semantic classes of instances, by the names that files give them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from solari_vk.errors import SolariError, quoted
from solari_vk.files import read_json
from solari_vk.scene import checks
from solari_vk.scene.model import Instance, Scene
from solari_vk.scene.objects import is_called

Classes = Mapping[str, str] | str | PathLike[str]


def label_instances(scene: Scene, classes: Classes) -> None:
    """Assign `label` of the instances whose names, or objects' names (`Instance.part_of`), fit a pattern; others stay
    as they are.

    classes: the class for each pattern, such as {"Chair*": "chair"}, or a JSON file of them. `*` stands for any
    characters, `?` for one, `[ab]` for one of some; of several patterns that fit a name the first counts. Raises
    SolariError for a file that isn't such an object, and for a pattern that fits no name.
    """
    for instance, label in find_labels(scene.instances[:], classes).items():
        instance.label = label


def find_labels(instances: Sequence[Instance], classes: Classes) -> dict[Instance, str]:
    """The labels that `label_instances` assigns, of these instances."""
    who = "labels"
    given: Any = classes
    if isinstance(classes, str | PathLike):
        path = Path(classes)
        who = f"labels {path}"
        given = read_json(path, who)
    if not isinstance(given, Mapping) or not all(isinstance(word, str) for pair in given.items() for word in pair):
        raise SolariError(f'{who}: give a class for each pattern of names, such as {{"Chair*": "chair"}}')
    for label in given.values():
        try:
            checks.line(label)
        except ValueError as error:
            raise SolariError(f"{who}: a class {error}") from None
    found, unused = dict[Instance, str](), dict(given)
    for instance in instances:
        fitting = [pattern for pattern in given if is_called(instance, pattern)]
        for pattern in fitting:
            unused.pop(pattern, None)
        if fitting:
            found[instance] = given[fitting[0]]
    if unused:
        names = sorted({instance.name for instance in instances if instance.name})
        raise SolariError(f"{who}: no instance is named {quoted(next(iter(unused)))}; names are "
                          f"{', '.join(map(quoted, names[:8]))}{', ...' if len(names) > 8 else ''}")  # fmt: skip
    return found
