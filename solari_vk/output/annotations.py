"""Annotations of pictures in which each pixel has the number of an instance: boxes, masks, COCO and YOLO.

Lin et al., "Microsoft COCO: Common Objects in Context" (2014), and its format of objects; the text files of YOLO.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import Hints, SolariError, checked_constructor, checked_keywords, quoted, unknown_name
from solari_vk.scene.model import Instance

NO_INSTANCE = 2**32 - 1
"""The `instance_id` of pixels without a surface."""
Ids = NDArray[np.uint32]
Points = Mapping[int, NDArray[np.float64]]


def boxes(ids: Ids) -> dict[int, tuple[int, int, int, int]]:
    """The smallest box around the pixels of each instance in ids (height, width): x, y, width and height in pixels."""
    numbers, of_pixel = np.unique(ids, return_inverse=True)
    rows, columns = np.divmod(np.arange(ids.size), ids.shape[1])
    places = np.stack([columns, rows], 1)
    # One pass over the pixels for all instances, of which a picture may show thousands.
    low = np.full((len(numbers), 2), np.iinfo(np.int64).max)
    high = np.full((len(numbers), 2), -1)
    np.minimum.at(low, of_pixel.ravel(), places)
    np.maximum.at(high, of_pixel.ravel(), places)
    found = np.concatenate([low, high - low + 1], axis=1).tolist()
    return {int(number): tuple(box) for number, box in zip(numbers, found, strict=True) if number != NO_INSTANCE}


def merged_ids(ids: Ids, objects: Mapping[int, Sequence[int]]) -> Ids:
    """The ids (height, width), with the number of an object's first part for all; objects: such as `frame.objects`."""
    first = {part: number for number, parts in objects.items() for part in parts}
    numbers, of_pixel = np.unique(ids, return_inverse=True)
    return np.array([first.get(n, n) for n in numbers.tolist()], np.uint32)[of_pixel].reshape(np.shape(ids))


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """COCO's uncompressed run lengths of a mask (height, width): column by column, the first run is outside of it."""
    # A pixel outside before the first one makes the first run, which may be empty, one outside of the mask.
    pixels = np.concatenate([[False], mask.T.ravel()])
    ends = np.flatnonzero(pixels[1:] != pixels[:-1])
    return [int(length) for length in np.diff([0, *ends, mask.size])]


@checked_keywords(who="solari_vk")
def instance_table(instances: Mapping[int, Instance], labels: Mapping[int, str]) -> dict[str, Any]:
    """What the numbers in `instance_id` mean, for a JSON file. labels: of the instances.

    transform: from the mesh, as joints and morph targets have it now, to the world; size: of the mesh's box, in its own
    space, from `lowest` on.
    """
    rows = []
    for number, instance in sorted(instances.items()):
        low, high = (bound(instance.posed_mesh().positions, axis=0) for bound in (np.min, np.max))
        rows.append(
            {
                "id": number,
                "name": instance.name,
                "label": labels[number],
                "part_of": instance.part_of,
                "material": instance.material.name,
                "transform": instance.transform.tolist(),
                "lowest": low.tolist(),
                "size": (high - low).tolist(),
            }
        )
    return {"no_instance": NO_INSTANCE, "instances": rows}


def checked_classes(classes: Any) -> list[str]:
    """A list of classes; raises SolariError for what isn't one, or names a class twice."""
    found: list[Any] = list(classes) if isinstance(classes, Iterable) and not isinstance(classes, str) else [None]
    if not all(isinstance(name, str) and name for name in found):
        raise SolariError(f"annotations: classes is a list of names, not {quoted(classes)}")
    if len(set(found)) < len(found):
        raise SolariError(f"annotations: classes names one twice: {', '.join(found)}")
    return found


@checked_keywords(who="solari_vk")
def merge_coco(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """One data set in COCO's format of several: what `Annotations.coco` returned, or json.load of annotations.json.

    Images and annotations are numbered anew, and categories of one name are one. Raises SolariError for what isn't in
    the format, for pictures of one name, and for keypoints of a category that differ.
    """
    merged: dict[str, Any] = {"images": [], "annotations": [], "categories": []}
    categories: dict[str, dict[str, Any]] = {}
    names: set[str] = set()
    if not isinstance(parts, Iterable):
        raise SolariError(f"merge_coco: parts is a list of data sets, not {quoted(parts)}")
    for number, part in enumerate(parts):
        try:
            _add_coco(merged, part, categories, names)
        except (KeyError, TypeError) as error:
            raise SolariError(f"merge_coco: part {number} isn't in COCO's format: {error!r}") from None
    return merged


def _add_coco(
    merged: dict[str, Any], part: Mapping[str, Any], categories: dict[str, dict[str, Any]], names: set[str]
) -> None:
    ids = {}
    for category in part["categories"]:
        name = category["name"]
        if name not in categories:
            categories[name] = {**category, "id": len(categories) + 1}
            merged["categories"].append(categories[name])
        elif category.get("keypoints") != categories[name].get("keypoints"):
            raise SolariError(f"merge_coco: the keypoints of {name!r} differ: give all data sets the same ones")
        ids[category["id"]] = categories[name]["id"]
    images = {}
    for image in part["images"]:
        if image["file_name"] in names:
            raise SolariError(
                f"merge_coco: two pictures are called {image['file_name']!r}: put their folders before file_name"
            )
        names.add(image["file_name"])
        images[image["id"]] = len(merged["images"]) + 1
        merged["images"].append({**image, "id": images[image["id"]]})
    for found in part["annotations"]:
        of = {"image_id": images[found["image_id"]], "category_id": ids[found["category_id"]]}
        merged["annotations"].append({**found, **of, "id": len(merged["annotations"]) + 1})


@checked_constructor
class Annotations(Hints):
    """Annotations of pictures of one scene; instances without a label have none. labels: of instances by number, such
    as `frame.labels`. keypoints: the names of instances' keypoints by number. objects: the numbers of each object's
    parts, such as `frame.objects`, which have one annotation; by default instances have their own. classes: those of a
    data set of several scenes, in the order of their numbers; by default the labels that are there, by the alphabet,
    which differ from scene to scene. Raises SolariError if there is no class, for a label that isn't one, and if
    objects of a class have other keypoints."""

    def __init__(
        self,
        labels: Mapping[int, str],
        keypoints: Mapping[int, Sequence[str]] | None = None,
        objects: Mapping[int, Sequence[int]] | None = None,
        classes: Sequence[str] | None = None,
    ) -> None:
        if not isinstance(labels, Mapping):
            raise SolariError(f"Annotations: labels are by number, such as frame.labels, not {quoted(labels)}")
        self.labels = {number: label for number, label in labels.items() if label}
        """The labels of the annotated instances, by number."""
        present = sorted(set(self.labels.values()))
        self.classes = present if classes is None else checked_classes(classes)
        for label in present:
            if label not in self.classes:
                what = "annotations: give null as the class of what isn't annotated; classes lack the label"
                raise unknown_name(what, label, self.classes)
        if not self.classes:
            raise SolariError(
                "annotations: no instance has a label: assign instance.label, or give a file of classes "
                "by --labels (label_instances)"
            )
        self.objects = self._annotated_objects(objects or {})
        """The numbers of the parts of each annotated object, by that of the first one, which is the annotation's."""
        self.keypoints = self._keypoints_of_classes(keypoints or {})
        """The names of the keypoints of each class that has any."""

    def _annotated_objects(self, objects: Mapping[int, Sequence[int]]) -> dict[int, list[int]]:
        """The objects that have a label, and as further ones the instances with a label that are no part of any."""
        found = {first: [*parts] for first, parts in objects.items() if first in self.labels}
        parts = {part for each in objects.values() for part in each}
        return found | {number: [number] for number in self.labels if number not in parts}

    def _keypoints_of_classes(self, keypoints: Mapping[int, Sequence[str]]) -> dict[str, tuple[str, ...]]:
        of_objects = {first: tuple(self.points_of(first, keypoints)) for first in self.objects}
        of_classes = {self.labels[first]: names for first, names in of_objects.items() if names}
        # COCO lists keypoints once for a class, not for each object.
        for first, names in of_objects.items():
            label = self.labels[first]
            if names != of_classes.get(label, ()):
                raise SolariError(
                    f"annotations: instances of the class {label!r} have other keypoints than "
                    f"{', '.join(of_classes[label])}: give all of a class the same ones, in the same order"
                )
        return of_classes

    def points_of(self, number: int, points: Mapping[int, Any]) -> Any:
        """The keypoints of an object, of those of all instances by number: of the first part that has any, or none."""
        return next((points[part] for part in self.objects[number] if part in points), ())

    def merged(self, ids: Ids) -> Ids:
        """The ids (height, width), with one number for all parts of an object."""
        return merged_ids(ids, self.objects)

    def _found(self, ids: Ids) -> Iterable[tuple[int, int, tuple[int, int, int, int]]]:
        """Number, class and box of each annotated instance in a picture. Raises SolariError for several pictures."""
        if np.ndim(ids) != 2:
            raise SolariError(f"Annotations: instance_id of one picture is (height, width), not {np.shape(ids)}")
        for number, box in boxes(ids).items():
            if number in self.objects:
                yield number, self.classes.index(self.labels[number]), box

    def coco(self, pictures: Iterable[tuple[str, Ids] | tuple[str, Ids, Points]]) -> dict[str, Any]:
        """Images, annotations and categories in COCO's format, for a JSON file. pictures: names of files, ids (height,
        width), and perhaps keypoints by instance's number, (count, 3): u, v and state, as of `keypoints`. Categories
        are counted from 1. Masks are run lengths; `instance_id` is the number of an object's first part.
        """
        images: list[dict[str, Any]] = []
        found: list[dict[str, Any]] = []
        for image, (name, ids, *points) in enumerate(pictures, 1):
            ids = self.merged(ids)
            annotated = list(self._found(ids))
            height, width = ids.shape
            images.append({"id": image, "file_name": name, "width": width, "height": height})
            for number, category, box in annotated:
                mask = ids == number
                found.append(
                    {
                        "id": len(found) + 1,
                        "image_id": image,
                        "category_id": category + 1,
                        "iscrowd": 0,
                        "bbox": list(box),
                        "area": int(mask.sum()),
                        "instance_id": number,
                        "segmentation": {"size": [height, width], "counts": run_lengths(mask)},
                    }
                )
                named = self.points_of(number, points[0] if points else {})
                if len(named):
                    # COCO has zeros for keypoints that it doesn't label.
                    rows = np.where(named[:, 2:] > 0, named, 0.0)
                    found[-1] |= {"keypoints": rows.ravel().tolist(), "num_keypoints": int((rows[:, 2] > 0).sum())}
        categories = [{"id": n, "name": name, **self._category(name)} for n, name in enumerate(self.classes, 1)]
        return {"images": images, "annotations": found, "categories": categories}

    def _category(self, label: str) -> dict[str, Any]:
        names = self.keypoints.get(label)
        return {} if names is None else {"keypoints": list(names), "skeleton": []}

    def yolo(self, ids: Ids) -> str:
        """A picture's lines: class from 0, then center and size of the box relative to the picture."""
        lines: list[str] = []
        height, width = ids.shape
        for _, category, (x, y, across, down) in self._found(self.merged(ids)):
            box = (x + across / 2) / width, (y + down / 2) / height, across / width, down / height
            lines.append(" ".join([str(category), *(f"{value:.6f}" for value in box)]) + "\n")
        return "".join(lines)
