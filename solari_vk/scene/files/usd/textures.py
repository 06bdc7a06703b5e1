"""Pictures of a stage's materials: which are read, and the arithmetic of UsdUVTexture that fields of Material lack."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pxr import Ar, Sdf

from solari_vk.base.budget import BudgetError, charge
from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.files import read_regular
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import clean
from solari_vk.scene.files.usd.stage import Folder
from solari_vk.scene.images import exr, image_files
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB, srgb_of_linear
from solari_vk.scene.images.radiance_files import read_colors
from solari_vk.scene.model import Texture, TextureImage

_WRAP = {"repeat": "repeat", "mirror": "mirrored_repeat", "clamp": "clamp_to_edge", "black": "clamp_to_edge"}
_BLACK = "textures that are black beyond their edge repeat the edge's pixels there"
_TILES = "of textures of several tiles (UDIM) only the first is shown"
MISSING = "textures whose image can't be read are replaced by their fallback"
_FIRST_TILE = "1001"
_BYTES_PER_PIXEL = 40  # of a picture whose values are changed
CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class Use:
    """A texture that a material's input is connected to. channel: "rgb", "r", "g", "b" or "a"."""

    place: str
    file: str
    channel: str = "rgb"
    scale: Four = (1.0, 1.0, 1.0, 1.0)
    bias: Four = (0.0, 0.0, 0.0, 0.0)
    wrap: tuple[str, str] = ("repeat", "repeat")
    space: str = "auto"
    uvs: str = "st"
    uv_transform: tuple[float, ...] = IDENTITY
    fallback: Four | None = None

    @property
    def lacking(self) -> Any:
        """What the input has where the picture can't be read; None for what it has by default."""
        if self.fallback is None:
            return None
        return self.fallback[:3] if self.channel == "rgb" else self.fallback[CHANNELS[self.channel]]

    @property
    def is_plain(self) -> bool:
        """Whether its values are those of the picture."""
        return self.scale == (1, 1, 1, 1) and self.bias == (0, 0, 0, 0)


class Files:
    """Reads the files that a stage names, inside its folder or a package there."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder

    def place(self, attribute: Any, time: Any) -> str:
        """Where the file is, or should be, that an attribute names, "" without one."""
        asset = attribute.Get(time) if attribute else None
        if asset is None or not asset.path:
            return ""
        if asset.resolvedPath:
            return str(asset.resolvedPath)
        # USD leaves names of tiles, and of files that are missing, as they are. They are relative to the layer that has
        # them.
        layer = attribute.GetPropertyStack(time)[0].layer
        found = str(Sdf.ComputeAssetPathRelativeToLayer(layer, asset.path))
        folder = os.path.dirname(layer.realPath or self.folder.file)
        return found if os.path.isabs(found) else os.path.join(folder, found)

    def read(self, place: str) -> bytes:
        """The content of a file. Raises SolariError for one that is outside or missing."""
        name = quoted(clean(os.path.basename(place)))
        if not self.folder.has(place):
            raise self.folder.outside("names the file", place)
        if not Ar.IsPackageRelativePath(place):
            return read_regular(Path(place), f"{self.folder.file}: the file {name}")
        found = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(place))
        if not found:
            raise self.folder.error(f"the package has no file {name}: pack it again")
        charge(found.GetSize(), self.folder.file, f"the file {name}")
        return bytes(found.GetBuffer())


def file_name(place: str) -> str:
    """The name of a file, which may be in a package."""
    return PurePath(place.rstrip("]").rsplit("[", 1)[-1]).name


class _Picture(NamedTuple):
    """Pixels (H, W, 4), the linear values (H, W, 4) of a file of floating-point numbers, else None, and whether colors
    are sRGB where nothing else is said."""

    pixels: NDArray[np.uint8]
    values: NDArray[np.float32] | None
    is_srgb: bool


class Textures:
    """Makes the textures of materials; equal uses share them."""

    def __init__(self, files: Files, report: Report) -> None:
        self._files = files
        self._report = report
        self._read: dict[tuple[str, bool], _Picture | None] = {}
        self._images: dict[Any, TextureImage] = {}
        self.uv_names: dict[str, int] = {}
        """The names of sets of uvs by their number in the textures of one material, which begins with none."""

    def has(self, use: Use) -> bool:
        """Whether a picture can be read; if not, that is reported."""
        return self._found(use) is not None

    def _picture(self, use: Use) -> _Picture:
        found = self._found(use)
        assert found is not None
        return found

    def _found(self, use: Use) -> _Picture | None:
        raw = use.space == "raw"
        key = use.file, raw
        if key not in self._read:
            self._read[key] = None
            try:
                place = use.file
                if "<UDIM>" in place:
                    self._report.add(_TILES, use.place)
                    place = place.replace("<UDIM>", _FIRST_TILE)
                self._read[key] = self._opened(place, use.place, raw)
            except BudgetError:
                raise
            except SolariError as error:
                self._report.lost(MISSING, error)
        return self._read[key]

    def _opened(self, place: str, where: str, raw: bool) -> _Picture:
        if not place:
            raise SolariError(f"{self._files.folder.file}: {where} names no file: give it one")
        name = file_name(place)
        who = f"{self._files.folder.file}: {where} ({quoted(clean(name))})"
        data = self._files.read(place)
        if name.lower().endswith(".hdr"):
            found = read_colors(name, data)
        else:
            image = image_files.open_image(data, who, image_files.MORE_FORMATS)
            if not isinstance(image, exr.ExrImage):
                return _Picture(image_files.decode(image, who, linear=raw), None, _is_srgb(image))
            found = image.colors(who)
        if not np.isfinite(found).all():
            raise SolariError(f"{who} holds NaN or infinite values: repair it in an image program")
        charge(16 * found.shape[0] * found.shape[1], who, "a texture")
        values = np.ones((*found.shape[:2], 4), np.float32)
        values[..., : found.shape[2]] = found
        return _Picture(_codes(values), values, False)

    def _linear(self, use: Use) -> NDArray[np.float32]:
        """Values (H, W, 4) as the shader has them: linear, scaled and biased."""
        pixels, values, _ = found = self._picture(use)
        charge(0, use.place, "a texture", working=_BYTES_PER_PIXEL * pixels.shape[0] * pixels.shape[1])
        if values is None:
            values = np.divide(pixels, 255, dtype=np.float32)
            if self._in_srgb(use, found.is_srgb):
                values[..., :3] = LINEAR_OF_SRGB[pixels[..., :3]]
        return np.asarray(values * np.array(use.scale) + np.array(use.bias), np.float32)

    def _in_srgb(self, use: Use, is_srgb: bool) -> bool:
        # UsdPreviewSurface: 8 bits with 3 or 4 channels are sRGB where neither the node nor the file says another.
        return is_srgb if use.space == "auto" else use.space.lower() not in ("raw", "linear", "lin_rec709")

    def _texture(self, use: Use, image: TextureImage) -> Texture:
        if "black" in use.wrap:
            self._report.add(_BLACK, use.place)
        wrap_u, wrap_v = (_WRAP.get(name, "repeat") for name in use.wrap)  # without metadata: as most programs do
        number = self.uv_names.setdefault(use.uvs, len(self.uv_names))
        # v increases upwards in USD, and downwards in the scene's textures.
        a, b, c, d, e, f = use.uv_transform
        flipped = np.array([[a, -b, b + c], [-d, e, 1 - e - f]], np.float32)
        return Texture(image, wrap_u=wrap_u, wrap_v=wrap_v, uv_transform=flipped, uv_set=number)

    def _image(self, key: Any, use: Use, make: Any) -> TextureImage:
        if key not in self._images:
            pixels = make()
            charge(pixels.nbytes, use.place, "a texture")
            self._images[key] = TextureImage(pixels, file_name(use.file))
        return self._images[key]

    def color(self, use: Use, alpha: Use | None = None, highest: float = 1.0) -> tuple[Texture, NDArray[np.float32]]:
        """A texture of sRGB colors with the alpha of another use, and the factor (3,) that it is multiplied by.
        highest: what neither the factor nor a color exceeds."""
        pixels, values, is_srgb = self._picture(use)
        scale = np.array(use.scale[:3], np.float32)
        plain = values is None and use.channel == "rgb" and use.bias == (0, 0, 0, 0) and self._in_srgb(use, is_srgb)
        plain = plain and 0 <= scale.min() <= scale.max() <= highest
        if alpha is not None:
            self._compare(use, alpha)
        own_alpha = alpha is None or (alpha.file == use.file and alpha.channel == "a" and alpha.is_plain)
        key: Any = "color", use.file, use.channel, use.space, alpha
        if plain:
            factor = scale
        else:
            values = self._linear(use)
            shown = values[..., :3] if use.channel == "rgb" else values[..., [CHANNELS[use.channel]] * 3]
            shown = shown.clip(0, highest)
            factor = np.full(3, max(float(shown.max()), 1.0), np.float32)
            key = (*key, use.scale, use.bias, highest)

        def make() -> NDArray[np.uint8]:
            made = pixels.copy()
            if not plain:
                made[..., :3] = srgb_of_linear(shown / factor)
            if alpha is None:
                made[..., 3] = 255
            elif not own_alpha:
                made[..., 3] = _resized(_codes(self.gray(alpha)), made.shape[:2])
            return made

        return self._texture(use, self._image(key, use, make)), factor

    def gray(self, use: Use) -> NDArray[np.float32]:
        """The values (H, W) of one channel."""
        values: NDArray[np.float32] = self._linear(use)[..., CHANNELS.get(use.channel, 0)]
        return values

    def packed(self, uses: dict[int, Use]) -> Texture:
        """A texture that has uses in channels by their numbers; 1 in the others."""
        first = next(iter(uses.values()))
        self._compare(*uses.values())

        def make() -> NDArray[np.uint8]:
            found = {channel: _codes(self.gray(use)) for channel, use in uses.items()}
            size = max((codes.shape for codes in found.values()), key=lambda shape: shape[0] * shape[1])
            made = np.full((*size, 4), 255, np.uint8)
            for channel, codes in found.items():
                made[..., channel] = _resized(codes, size)
            return made

        return self._texture(first, self._image(("packed", *uses.items()), first, make))

    def _compare(self, *uses: Use) -> None:
        if len({(use.uvs, use.uv_transform, use.wrap) for use in uses}) > 1:
            self._report.add("textures of one surface with different uvs take those of the first", uses[0].place)

    def normal(self, use: Use) -> Texture:
        """A texture of normals, whose codes 0 to 255 are -1 to 1."""
        usual = use.scale[:3] == (2, 2, 2) and use.bias[:3] == (-1, -1, -1)

        def make() -> NDArray[np.uint8]:
            values = self._linear(use)
            # Without a scale and bias, codes are meant as usual, since no normal has only positive parts.
            shown = values if use.is_plain else values / 2 + 0.5
            made = np.full(values.shape, 255, np.uint8)
            made[..., :3] = _codes(shown[..., :3])
            return made

        found = self._picture(use)
        key = "normal", use.file, use.space, use.scale, use.bias
        as_it_is = usual and not self._in_srgb(use, found.is_srgb)
        return self._texture(use, self._image(key, use, found.pixels.copy if as_it_is else make))


def _is_srgb(image: Any) -> bool:
    """Whether a picture has 8 bits in each of 3 or 4 channels."""
    mode = getattr(image, "mode", "RGBA")
    deep = "16" in str(getattr(image, "tile", ""))
    return mode in ("RGB", "RGBA", "P", "CMYK", "YCbCr") and not deep


def _codes(values: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(np.rint(255 * np.clip(values, 0, 1)), np.uint8)


def _resized(codes: NDArray[np.uint8], size: tuple[int, ...]) -> NDArray[np.uint8]:
    """Nearest pixels of a picture (H, W) for another size."""
    rows, columns = (np.arange(new) * old // new for new, old in zip(size, codes.shape, strict=True))
    return np.asarray(codes[rows[:, None], columns])
