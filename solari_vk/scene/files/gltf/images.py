"""Images of a glTF file: each is decoded once, in parallel. One that can't be read costs its texture, not the file."""

from __future__ import annotations

import os
from collections.abc import Container
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import BudgetError
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.files.libraries import INSTALL
from solari_vk.scene.images import image_files
from solari_vk.scene.images.exr import IDENTIFIER
from solari_vk.scene.images.radiance_files import LITTLE_NEGATIVE, light_of
from solari_vk.scene.model import TextureImage

_BYTES_OF_LIGHT = 48  # of a pixel, with what the environment computes from it

Source = tuple[str, str | int]  # equal sources are the same image
_Opened = tuple[Any, str, str]  # an opened image, the words for it in errors, and its name
Choice = tuple[int, ...]  # images of one texture, the preferred one first


class Images:
    """Reads images by their numbers in the file, and keeps them."""

    def __init__(self, document: Document, report: Report, strict: bool) -> None:
        """strict: whether an image that can't be read is an error."""
        self._document = document
        self._report = report
        self._strict = strict
        self._made: dict[Source, TextureImage | None] = {}
        self._read: dict[int, TextureImage | None] = {}

    def read(self, users: dict[Choice, Entry], linear: Container[int] = ()) -> None:
        """Read an image of each choice: the first, and where that fails the next. users: what refers to them.

        linear: the images that hold data and not colors.
        """
        # Each round tries the next choice of those whose image failed.
        while users:
            self._read_all({choice[0]: user for choice, user in users.items()}, linear)
            failed = (choice for choice in users if self._read[choice[0]] is None and len(choice) > 1)
            users = {choice[1:]: users[choice] for choice in failed}

    def __getitem__(self, choice: Choice) -> TextureImage | None:
        """The image of a choice, after `read`; None if there is none that can be read."""
        for number in choice:
            image = self._read.get(number)
            if image is not None:
                return image
        return None

    def light(self, number: int, user: Entry) -> NDArray[np.float32] | None:
        """The linear colors (H, W, 3) of an EXR image, of any brightness; None for others, and without one.

        Raises SolariError for colors that aren't light, see `light_of`.
        """
        entry = self._document.item("image", number, user)
        try:
            source = self._source(entry)
            file = self._file(entry, source[1])
            # By content: the MIME type of the file may be wrong.
            if file[:4].tobytes() != IDENTIFIER:
                return None
            entry.charge(0, "its file", working=file.nbytes)
            image, who, _ = self._open(entry, source, file.tobytes())
            entry.charge(_BYTES_OF_LIGHT * image.width * image.height, "the map of its sky")
            colors: NDArray[np.float32] = image.colors(who)[..., :3]
        except BudgetError:
            raise
        except SolariError:
            return None  # `read` remarks it
        light, is_clipped = light_of(colors, who)
        if is_clipped:
            self._report.add(f"pictures hold {LITTLE_NEGATIVE}", entry.place)
        return light

    def _read_all(self, users: dict[int, Entry], linear: Container[int]) -> None:
        """Read images by their numbers. users: what refers to each."""
        sources: dict[int, Source] = {}
        opened: dict[Source, _Opened] = {}
        copied = 0  # bytes of files, which stay in memory until they are decoded
        for number, user in users.items():
            entry = self._document.item("image", number, user)
            try:
                source = sources[number] = self._source(entry)
                if source not in self._made and source not in opened:
                    file = self._file(entry, source[1])
                    # Pillow and the other libraries read from copies.
                    copied += file.nbytes
                    entry.charge(0, "its file", working=copied)
                    opened[source] = self._open(entry, source, file.tobytes())
            except BudgetError:
                raise
            except SolariError as error:
                self._remark(error)
        data = {source for number, source in sources.items() if number in linear}
        self._decode(opened, data, copied)
        for number in users:
            self._read[number] = self._made.get(sources[number]) if number in sources else None

    def _decode(self, opened: dict[Source, _Opened], data: set[Source], copied: int) -> None:
        """Decode opened images in parallel: the libraries let other threads run meanwhile. data: those that hold no
        colors. copied: the bytes of their files."""

        def decoded(source: Source) -> TextureImage | SolariError:
            image, who, name = opened[source]
            try:
                return TextureImage(pixels=image_files.decode(image, who, linear=source in data), name=name)
            except SolariError as error:
                return error

        threads = min(8, os.cpu_count() or 1)
        # At worst the largest images are decoded at the same time.
        working = sorted(image_files.working_bytes(image) for image, *_ in opened.values())[-threads:]
        self._document.root.charge(0, "decoding its images", working=sum(working) + copied)
        with ThreadPoolExecutor(max_workers=threads) as pool:
            for source, made in zip(opened, pool.map(decoded, opened), strict=True):
                if isinstance(made, SolariError):
                    self._made[source] = None
                    self._remark(made)
                else:
                    self._made[source] = made

    def _remark(self, error: SolariError) -> None:
        if self._strict:
            raise error
        place = str(error).removeprefix(f"{self._document.file}: ")
        why = "needs a missing library" if INSTALL in place else "can't be read"  # which is to be named in any case
        self._report.add(f"textures whose image {why} are replaced by another image or their factor", place)

    def _source(self, entry: Entry) -> Source:
        if "uri" not in entry:
            return "view", entry.integer("bufferView")
        uri = entry.text("uri")
        return ("data", uri) if uri[:5].lower() == "data:" else ("file", str(self._document.resource_path(entry)))

    def _file(self, entry: Entry, place: str | int) -> NDArray[np.uint8]:
        return self._document.view(place, entry)[0] if isinstance(place, int) else self._document.resource(entry)

    def _open(self, entry: Entry, source: Source, data: bytes) -> _Opened:
        file = os.path.basename(str(source[1])) if source[0] == "file" else ""
        # The name of the file helps to find an image that the JSON has by number.
        who = f"{entry.file}: {entry.place}" + (f" ({file})" if file else "")
        image = image_files.open_image(data, who)
        return image, who, os.path.basename(entry.name) or file or entry.place
