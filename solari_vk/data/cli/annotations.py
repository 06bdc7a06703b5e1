"""The labels of a rendered data set, from its files: COCO, YOLO, boxes in space, BOP, and shards of all."""

from __future__ import annotations

import copy
import json
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, read_json, read_npy, write_whole
from solari_vk.data.annotate.bop import BopWriter
from solari_vk.data.annotate.boxes import box_around
from solari_vk.data.annotate.silhouettes import Silhouette, merge_runs, read_runs
from solari_vk.data.cluster import Style, View
from solari_vk.data.datasets.dataset import NAME
from solari_vk.data.datasets.tasks import KEYPOINTS, SILHOUETTES
from solari_vk.data.datasets.views import COCO
from solari_vk.output.annotations import Annotations, boxes
from solari_vk.output.shards import save_shards
from solari_vk.scene.model import Camera, Instance, Scene

# Files and folders of a data set.
CLASSES = "classes.txt"
BOP = "bop"
SHARDS = "shards"
OBJECTS = "objects"
ANNOTATIONS = {
    "coco": ("instance_id",),
    "yolo": ("instance_id",),
    "objects": ("instance_id", SILHOUETTES),
    "bop": ("instance_id", SILHOUETTES, "depth"),
}
"""The kinds of annotations, each with the layers that it is made of."""


class AnnotationWriter:
    """Writes annotations of all views of a folder. instances: of the scene, by the numbers in instance_id. split: of
    BOP."""

    def __init__(
        self,
        folder: Path,
        annotations: Annotations,
        instances: Mapping[int, Instance],
        style: Style,
        scene: Scene,
        split: str,
    ) -> None:
        self._folder = folder
        self._annotations = annotations
        self._style = style
        self._scene = scene
        self._labels = annotations.labels
        self._split = split
        self._instances = {number: instances[number] for number in self._labels}

    def check(self, kinds: Sequence[str], cameras: Sequence[Camera]) -> None:
        """Raise SolariError, before anything is rendered, for what a format doesn't have. cameras: those of the views,
        before the randomizer."""
        if "bop" not in kinds:
            return
        bop = self._bop()
        randomizer = self._style.randomizer
        for number, original in enumerate(cameras):
            camera = copy.deepcopy(original)
            if randomizer is not None:
                randomizer.camera(camera, number)
            with self._style.randomized(self._scene, number):
                bop.check(camera)

    def _bop(self) -> BopWriter:
        """The objects have the sizes of the first view."""
        with self._style.randomized(self._scene, 0):
            return BopWriter(self._folder / BOP, self._instances, labels=self._labels, split=self._split)

    def write(self, kinds: Sequence[str], views: Sequence[View]) -> None:
        """Write these of ANNOTATIONS. Raises SolariError for a file that can't be written, and for what a format
        doesn't have."""
        # COCO has one file for all pictures, and reads them one by one from the generator: a data set may be larger
        # than memory.
        pictures = self._pictures(kinds, views)
        if "yolo" in kinds:
            write_whole(self._folder / CLASSES, "".join(f"{name}\n" for name in self._annotations.classes))
        if "coco" in kinds:
            write_whole(self._folder / COCO, json.dumps(self._annotations.coco(pictures)))
        else:
            deque(pictures, 0)  # runs the generator, which writes all but COCO's file

    def _pictures(
        self, kinds: Sequence[str], views: Sequence[View]
    ) -> Iterator[tuple[str, NDArray[Any], dict[int, NDArray[Any]]]]:
        """The name, the ids and the keypoints of each picture, whose other annotations are written on the way: each
        file is read once."""
        bop = self._bop() if "bop" in kinds else None
        for number, view in enumerate(views):
            ids = self._layer(view, "instance_id")
            points = self._points(view)
            if "yolo" in kinds:
                write_whole(self._folder / f"{Path(view.name).stem}.txt", self._annotations.yolo(ids))
            # Boxes and poses are those of the scene as the randomizer made it for this view.
            if bop is not None or "objects" in kinds:
                with self._style.randomized(self._scene, number):
                    silhouettes = self._silhouettes(view, ids)
                    if "objects" in kinds:
                        rows = self._objects(view.camera, silhouettes, points)
                        write_whole(self._folder / f"{Path(view.name).stem}.{OBJECTS}.json", json.dumps(rows))
                    if bop is not None:
                        picture = (self._folder / view.name).read_bytes()
                        bop.add(number, view.camera, picture, self._layer(view, "depth"), silhouettes)
            yield view.name, ids, points
        if bop is not None:
            bop.finish()

    def _silhouettes(self, view: View, ids: NDArray[Any]) -> dict[int, Silhouette]:
        """The silhouettes of the objects that a picture may show, by their first part's number."""
        objects = self._annotations.objects
        shown = {}
        for row, parts in objects.items():
            if any(self._instances[part].visible for part in parts):
                shown[row] = np.isin(ids, parts)
        return read_runs(merge_runs(self._layer(view, SILHOUETTES), objects), shown)

    def _layer(self, view: View, name: str) -> NDArray[Any]:
        path = self._folder / f"{Path(view.name).stem}.{name}.npy"
        return read_npy(path, f"{path}")

    def _points(self, view: View) -> dict[int, NDArray[Any]]:
        """u, v and state of the keypoints of each instance that has any."""
        if KEYPOINTS not in self._style.layers:
            return {}
        rows = self._layer(view, KEYPOINTS)
        return {int(number): rows[rows[:, 0] == number, 1:] for number in np.unique(rows[:, 0])}

    def _objects(
        self, camera: Camera, silhouettes: Mapping[int, Silhouette], points: Mapping[int, NDArray[Any]]
    ) -> list[dict[str, Any]]:
        """The instances that are in a picture, or would be if nothing were before them."""
        seen = {number: silhouette for number, silhouette in silhouettes.items() if silhouette.pixel_count}
        return [self._object(number, silhouette, camera, points) for number, silhouette in seen.items()]

    def _object(
        self, number: int, silhouette: Silhouette, camera: Camera, points: Mapping[int, NDArray[Any]]
    ) -> dict[str, Any]:
        parts = [self._instances[part] for part in self._annotations.objects[number]]
        box = box_around(parts, camera, self._style.size)
        row = {
            "id": number,
            "name": parts[0].part_of if len(parts) > 1 else parts[0].name,
            "label": self._labels[number],
            "center": box.center.tolist(),
            "rotation": box.rotation.tolist(),
            "size": box.size.tolist(),
            # JSON has no NaN: a corner that the camera doesn't see is null.
            "corners": [corner if np.isfinite(corner).all() else None for corner in box.pixels.tolist()],
            # `boxes` reads instance ids, of which one says "this object" and the next one "anything else".
            "box": boxes(np.where(silhouette.visible, number, number + 1)).get(number),
            "whole_box": silhouette.box,
            "visible_fraction": silhouette.fraction,
        }
        named = self._annotations.points_of(number, points)
        if len(named):
            places = [point if np.isfinite(point).all() else [None, None, 0] for point in named.tolist()]
            names = self._annotations.keypoints[self._labels[number]]
            row["keypoints"] = dict(zip(names, places, strict=True))
        return row


def write_shards(folder: Path, per_shard: int) -> None:
    """Write all files of a folder's views into tar files, with the camera of each as "json"."""
    transforms = read_json(folder / NAME, str(folder / NAME))
    frames = transforms.pop("frames")

    def samples() -> Iterator[tuple[str, dict[str, Any]]]:
        for frame in frames:
            stem = Path(frame["file_path"]).stem
            # WebDataset: the files of a sample have one name before the first dot, and what follows is the key.
            files = {path.name.removeprefix(f"{stem}."): path for path in sorted(folder.glob(f"{stem}.*"))}
            if not files:
                raise SolariError(f"{folder / frame['file_path']}: is missing: render the data set again")
            yield stem, {**files, "json": {**transforms, **frame}}

    make_folder(folder / SHARDS)
    save_shards(folder / SHARDS, samples(), per_shard=per_shard)
