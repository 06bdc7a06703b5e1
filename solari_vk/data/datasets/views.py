"""A rendered data set as a sequence of samples, as PyTorch's DataLoader and others take it."""

from __future__ import annotations

import operator
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import Hints, SolariError, checked_constructor, quoted, unknown_name
from solari_vk.base.files import read_json, read_npy
from solari_vk.data.datasets.dataset import NAME, cameras_for
from solari_vk.data.datasets.tasks import TRACED
from solari_vk.scene.images.image_files import read_pixels
from solari_vk.scene.model import Camera, Scene

PICTURES = (".png", ".jpg", ".npy")
COCO = "annotations.json"
OF_COCO = ("boxes", "labels", "masks")


class Sample(dict[str, NDArray[Any]]):
    """The layers of a view, by name."""

    def __missing__(self, name: str) -> NoReturn:
        raise SolariError(
            f"Views: samples have {', '.join(self)}, and no {name}: name what they shall have, "
            f"Views(folder, [{', '.join(map(repr, (*self, name)))}])"
        )


@checked_constructor
class Views(Hints):
    """The views in a folder of `solari-vk dataset`.

    views[n] is a sample: a dict of "rgb" (height, width, 3), float32, sRGB from 0 to 1, of .npy files radiance in
    cd/m^2, and of the other layers by name. `torch.utils.data.DataLoader(Views(folder), batch_size=8)` gives tensors.
    Ids are int32, -1 where there is nothing. names: what samples have, by default "rgb" and all layers but silhouettes,
    keypoints and optical flow. Data sets with `--annotations coco` also have, if named, "boxes" (N, 4), left, top,
    right and bottom in pixels, "labels" (N,), the categories, and "masks" (N, height, width) of the N things in a view,
    as detectors of torchvision take them. Raises SolariError for a folder that isn't a data set, for an unknown name,
    and for files that can't be read.
    """

    def __init__(self, folder: str | os.PathLike[str], names: Sequence[str] | None = None) -> None:
        self.folder = Path(folder)
        path = self.folder / NAME
        data = read_json(path, str(path))
        try:
            suffix = Path(data["frames"][0]["file_path"]).suffix
            # .exr and .npz files hold their layers themselves.
            if suffix not in PICTURES:
                raise SolariError(f"{path}: its pictures are {suffix} files: Views reads {', '.join(PICTURES)}")
            self._frames: list[dict[str, Any]] = list(data["frames"])
            self.size: tuple[int, int] = (int(data["w"]), int(data["h"]))
            if min(self.size) < 1:
                raise ValueError(f"a size of {self.size}")
            self._known = ("rgb", *data["layers"])
            # Here, so that no sample fails later for what is wrong in this file.
            self._paths = [self._checked({"rgb": frame["file_path"], **frame["layer_paths"]}) for frame in self._frames]
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise SolariError(f"{path}: isn't one that `solari-vk dataset` wrote: {error!r}") from None
        self.names = tuple(name for name in self._known if name not in TRACED) if names is None else tuple(names)
        """What samples have."""
        self._coco: dict[str, list[dict[str, Any]]] | None = None
        if (self.folder / COCO).exists():
            self._known += OF_COCO
            if not set(OF_COCO).isdisjoint(self.names):
                self._coco = self._read_coco()
        for name in self.names:
            if name not in self._known:
                raise unknown_name(f"{path}: views have no", name, self._known)
        self.cameras: list[Camera] = cameras_for(str(path), Scene(), Camera(), None, self.size[0] / self.size[1], 0)
        """The camera of each view, with its exposure; `camera.rays(pixels, views.size)` are the rays of pixels."""

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, number: int) -> Sample:
        # The list's own IndexError ends `for` loops over views, as Python's sequences do.
        paths = self._paths[operator.index(number)]
        read = {name: self._read(self.folder / paths[name]) for name in self.names if name not in OF_COCO}
        if self._coco is not None:
            with load_budget():
                read |= self._things(paths["rgb"], self._coco)
        return Sample({name: read[name] for name in self.names})

    def _read_coco(self) -> dict[str, list[dict[str, Any]]]:
        """The annotations of each picture, by its file."""
        path = self.folder / COCO
        data = read_json(path, str(path))
        try:
            files = {image["id"]: image["file_name"] for image in data["images"]}
            found: dict[str, list[dict[str, Any]]] = {name: [] for name in files.values()}
            for one in data["annotations"]:
                found[files[one["image_id"]]].append(one)
        except (KeyError, TypeError) as error:
            raise SolariError(f"{path}: isn't one that `solari-vk dataset` wrote: {error!r}") from None
        return found

    def _things(self, file_name: str, coco: dict[str, list[dict[str, Any]]]) -> dict[str, NDArray[Any]]:
        width, height = self.size
        try:
            found = coco[file_name]
            boxes = np.array([one["bbox"] for one in found], np.float32).reshape(-1, 4)
            charge(len(found) * width * height, str(self.folder / COCO), "the masks of a view")
            masks = np.zeros((len(found), width, height), np.bool_)
            for mask, one in zip(masks, found, strict=True):
                # Column by column, beginning outside.
                runs = one["segmentation"]["counts"]
                if sum(runs) != mask.size:
                    raise ValueError("a mask of another size")
                mask.ravel()[:] = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
            labels = np.array([one["category_id"] for one in found], np.int64)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"{self.folder / COCO}: lacks what {file_name} shows: {error!r}") from None
        boxes[:, 2:] += boxes[:, :2]
        return dict(zip(OF_COCO, (boxes, labels, masks.swapaxes(1, 2)), strict=True))

    def _checked(self, paths: dict[str, str]) -> dict[str, str]:
        """The files of a view by layer. ValueError for one outside the folder: it is a data set of anybody's."""
        for name in self._known:
            if Path(paths[name]).anchor or ".." in Path(paths[name]).parts:  # a drive alone leads elsewhere, too
                raise ValueError(f"{quoted(paths[name])} is outside the folder")
        return paths

    def _read(self, file: Path) -> NDArray[Any]:
        # Codes of 8 bits become 0 to 1; their alpha, which pictures of a data set don't use, is left out.
        if file.suffix != ".npy":
            return (read_pixels(file)[..., :3] / np.float32(255)).astype(np.float32)
        read = read_npy(file, f"{file}")
        # PyTorch compares no unsigned ids. NO_INSTANCE becomes -1.
        return read.view(np.int32) if read.dtype == np.uint32 else read

    def objects(self, number: int) -> list[dict[str, Any]]:
        """The boxes in space of a view, as `--annotations objects` writes them."""
        path = self.folder / f"{Path(self._frames[operator.index(number)]['file_path']).stem}.objects.json"
        found: list[dict[str, Any]] = read_json(path, f"{path}")
        return found
