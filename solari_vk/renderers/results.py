"""The frame that `render` returns."""

from __future__ import annotations

import importlib
import math
import operator
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import Hints, SolariError, checked_keywords, quoted, unknown_name, warn
from solari_vk.base.files import followed
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import Projection
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.output.annotations import boxes, merged_ids
from solari_vk.output.picture import (
    EIGHT_BIT,
    check_alpha,
    open_on_desktop,
    png_bytes,
    save_image,
    why_no_desktop,
    write_beside,
    write_codes,
)
from solari_vk.output.tone_mapping import encode_picture, misexposed, unseen
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.renderers.first_hit_reader import FirstHitReader
from solari_vk.scene.camera import exposure_of
from solari_vk.scene.group import Group
from solari_vk.scene.model import Camera, Instance, Material
from solari_vk.scene.objects import objects_of


class Source(Protocol):
    """The renderer of a frame."""

    device: Device
    binder: SceneBinder
    size: tuple[int, int]
    view: str
    tonemap: str
    first_hits: FirstHitReader
    warned_of_darkness: bool | None

    @property
    def gbuffer(self) -> str: ...
    @property
    def outputs(self) -> tuple[str, ...]: ...
    def read(self, name: str) -> NDArray[Any]: ...
    def tensor(self, name: str) -> NDArray[Any] | CudaTensor: ...
    def resource(self, name: str) -> Any: ...
    def auto_exposure(self, radiance: NDArray[Any] | None = None) -> float: ...
    def cut_out(self, radiance: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def check_latest(self, frame: RenderedFrame, name: str) -> None: ...


class RenderedFrame(Hints):
    """The results of one frame as numpy arrays, by name, until the renderer renders its next frame.

    `frame["radiance"]` is linear radiance (height, width, 3) in cd/m^2; `np.asarray(frame)` is the same. With
    the setting `upscale`, parts of the light and guides of the realtime renderer have the size that was rendered.
    `frame["depth"]` and the other names of `first_hits.FIRST_HITS` describe what is visible at the center of each
    pixel; they are computed on demand. `keys()` lists all of these names. Buffers and images of the renderer's shaders
    can be read by their names too. Reading a result waits for the frame and returns a copy.

    Raises SolariError for an unknown name, after a later frame has been rendered, and after the renderer was closed.
    """

    __slots__ = ("_projection", "_renderer", "_timeline_value", "camera", "exposed", "size")

    def __init__(
        self, renderer: Source, camera: Camera, projection: Projection, timeline_value: int, *, exposed: bool = False
    ) -> None:
        self._renderer = renderer
        self._projection = projection
        self._timeline_value = timeline_value
        self.camera = camera
        """The camera that the frame shows, with a shutter that of the exposure's middle. It may be edited later."""
        self.exposed = exposed
        """Whether the frame was exposed with a shutter."""
        self.size = renderer.size
        """Width and height in pixels."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        renderer = self._renderer
        renderer.check_latest(self, name)
        # Words that people try first, and that could mean either of two results.
        if name in ("picture", "image"):
            raise SolariError(f"frames have no result '{name}': image() is the picture in 8 bits, 'radiance' in cd/m^2")
        if name in FIRST_HITS:
            return renderer.first_hits.read(name, self._projection, self.size, renderer.gbuffer == "traced")
        return renderer.read(name)

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        """`frame[name]` as a tensor that stays on an NVIDIA device: `torch.from_dlpack(frame.tensor("radiance"))`.

        It is a copy that later frames don't change. The host doesn't wait: the stream that takes it does. Numbers of
        instances are int32, -1 for none. On software devices it is the array `frame[name]`. Raises SolariError, with
        the reason, where CUDA can't share memory with the device, and for results that are made on the host.
        """
        renderer = self._renderer
        renderer.check_latest(self, name)
        if name in FIRST_HITS:
            return renderer.first_hits.tensor(name, self._projection, self.size, renderer.gbuffer == "traced")
        return renderer.tensor(name)

    def filtered(self, name: str) -> NDArray[Any]:
        """A result at the centers of pixels as the mean over each pixel's area, of 16 rays that hit rays' meshes.

        name: of `first_hits.FIRST_HITS` without ids. Where a ray meets nothing, depth and distance are inf, the
        others are 0. Raises SolariError for another name.
        """
        self._renderer.check_latest(self, name)
        names = [known for known, output in FIRST_HITS.items() if output.has_mean]
        if name not in names:
            raise unknown_name("RenderedFrame.filtered: there is no mean of", name, names)
        [mean] = self._renderer.first_hits.read_means([name], self._projection, self.size)
        return mean

    def keys(self) -> list[str]:
        """The names of the results."""
        return list(self._renderer.outputs)

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __contains__(self, name: object) -> bool:
        return name in self._renderer.outputs

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self["radiance"], dtype)

    def wait(self) -> Self:
        """Wait until the device has finished the frame; returns the frame."""
        self._renderer.device.await_value(self._timeline_value)
        return self

    def resource(self, name: str) -> Any:
        """The Buffer or Image that a name of the shaders means in this frame."""
        self._renderer.check_latest(self, name)
        return self._renderer.resource(name)

    @property
    def instances(self) -> dict[int, Instance]:
        """The scene's instances by the numbers in `frame["instance_id"]`."""
        return self._renderer.binder.instances

    @property
    def materials(self) -> dict[int, Material]:
        """The scene's materials by the numbers in `frame["material_id"]`."""
        return self._renderer.binder.materials.by_row

    def mask(self, instance: Instance | Group | str | Sequence[Instance]) -> NDArray[np.bool_]:
        """Whether pixels show an instance at their center, (height, width). instance: the object, a group or a list of
        them, a name, of which all count that have it, or that of an object of several parts. Raises SolariError for
        what isn't in the scene."""
        found: Sequence[Any]
        if isinstance(instance, str):
            found = self._named(instance)
        elif isinstance(instance, Group):
            found = instance.items
        elif isinstance(instance, Sequence):
            found = instance
        else:
            found = [instance]
        ids = [number for number, other in self.instances.items() if other in found]
        if not ids:
            raise SolariError(f"mask: takes an instance or a group of the scene, or its name, not {quoted(instance)}")
        return np.isin(self["instance_id"], ids)

    def _named(self, name: str) -> list[Instance]:
        """The instances of an object of several parts, or else all of that name."""
        instances = list(self.instances.values())
        # The name of an object counts before that of an instance, which may be one of its parts.
        found = [other for other in instances if other.part_of == name] if name else []
        found = found or [other for other in instances if other.name == name]
        if not found and name in self.labels.values():
            raise SolariError(
                f"mask: {quoted(name)} is a label, which several objects have: "
                f"frame.mask([one for one in scene if one.label == {quoted(name)}])"
            )
        return found or [self._renderer.binder.scene.instances[name]]

    @property
    def labels(self) -> dict[int, str]:
        """The labels of the scene's instances by the numbers in `frame["instance_id"]`, "" for those without one."""
        return {number: instance.label for number, instance in self.instances.items()}

    @property
    def objects(self) -> dict[int, list[int]]:
        """The numbers in `frame["instance_id"]` of each object's parts (`Instance.part_of`) that have one label, by the
        first one; an instance alone is an object."""
        return objects_of(self.instances, self.labels)

    def boxes(self, *, merge: bool = False) -> dict[Instance, tuple[int, int, int, int]]:
        """The smallest box around each instance's pixels: its left column, top row, width and height in pixels.

        merge: one box around all parts of an object (`frame.objects`), by its first part.
        """
        ids = self["instance_id"]
        instances = self.instances
        if merge:
            ids = merged_ids(ids, self.objects)
        return {instances[number]: box for number, box in boxes(ids).items()}

    @checked_keywords()
    def pick(self, x: int, y: int) -> Instance | None:
        """The instance that a pixel shows at its center, None for the background.

        x, y: the column and the row, counted from the top left. Raises SolariError outside of the picture.
        """
        width, height = self.size
        try:
            column, row = operator.index(x), operator.index(y)
        except TypeError:
            column = row = -1
        if not (0 <= column < width and 0 <= row < height):
            raise SolariError(
                f"pick: a pixel is two whole numbers, from 0, 0 to {width - 1}, {height - 1}, not {quoted((x, y))}"
            )
        return self.instances.get(int(self["instance_id"][row, column]))

    def image(self, *, exposure: float | str | None = None, tonemap: str | None = None) -> NDArray[np.uint8]:
        """The picture as screens show it: sRGB codes (height, width, 3) from 0 to 255.

        exposure: the factor by which radiance is multiplied, by default the camera's; "auto" chooses it by the picture,
        as happens, with a warning, where nothing could be seen otherwise. tonemap: the tone curve, by default the
        renderer's. While the renderer shows a debug view, this is `frame["display"]`. Raises SolariError for another
        exposure or tone curve.
        """
        if self._renderer.view != "picture":
            return np.asarray(self["display"][..., :3])
        radiance = self["radiance"]
        curve = tonemap or self._renderer.tonemap
        return encode_picture(radiance, exposure=self._exposure_factor(radiance, exposure, curve), curve=curve)

    def _exposure_factor(self, radiance: NDArray[Any], exposure: float | str | None, curve: str) -> float:
        """The factor that an exposure means for a picture. Warns of one in which nothing can be seen, and of another
        exposure than the camera's."""
        if isinstance(exposure, str):
            if exposure != "auto":
                raise SolariError(f"exposure is a factor or 'auto', not {quoted(exposure)}")
            return exposure_of(self._renderer.auto_exposure(radiance))
        camera = self.camera
        # Nobody has set the exposure of such a camera: it may be replaced where it suits the picture badly.
        is_unset = exposure is None and not camera.has_exposure
        if exposure is not None:
            factor = exposure
        elif is_unset:
            factor = exposure_of(self._unset_ev100)
        else:
            factor = camera.exposure
        wrong = unseen(radiance * factor)
        if wrong == "black":
            if not self._renderer.warned_of_darkness:
                warn(
                    "the picture is black: the scene's lights don't reach it. Lights are those of scene.lights, "
                    "instances with an emissive material, scene.environment, and studio_lights(scene)"
                )
            return factor
        if wrong and exposure is not None:
            warn(f'the picture is far too {wrong}: give another exposure, or "auto"')
            return factor
        far = "far " if wrong else ""
        if is_unset and not wrong:
            wrong = self._misexposed(radiance, factor, curve)
        if not wrong:
            return factor
        return exposure_of(self._replaced_ev100(radiance, f"{far}too {wrong}", is_unset))

    @property
    def _unset_ev100(self) -> float:
        """The EV100 that was chosen for the camera when it had none, or its default."""
        return float(getattr(self.camera, "_metered_ev100", self.camera.ev100))

    def _replaced_ev100(self, radiance: NDArray[Any], wrong: str, is_unset: bool) -> float:
        """The EV100 that suits a picture which would be too dark or too bright; warns that it is another one."""
        camera = self.camera
        tried = self._unset_ev100 if is_unset else camera.ev100
        unset = ", which nobody set" if is_unset else ""
        shown = self._renderer.auto_exposure(radiance)
        if is_unset:
            object.__setattr__(
                camera, "_metered_ev100", shown
            )  # so that the next pictures by this camera don't flicker
        warn(
            f"the picture would be {wrong} with the camera's EV100, {tried:.4g}{unset}, and is "
            f"shown with {shown:.3g}: set camera.ev100 to that, or camera.auto_exposure"
        )
        return shown

    def _misexposed(self, radiance: NDArray[Any], factor: float, curve: str) -> str:
        """Whether surfaces that don't emit are too "bright" or too "dark" in the picture; "" if neither."""
        codes = encode_picture(radiance, exposure=factor, curve=curve)
        # Most pictures are well exposed as a whole, and need no first hits.
        if not misexposed(codes):
            return ""
        surfaces = np.isfinite(self["depth"])
        if surfaces.mean() < 0.01:  # too few to say more than the background does
            return misexposed(codes)
        return misexposed(codes[surfaces & ~self["emissive"].any(axis=-1)])

    def settle_exposure(self) -> None:
        """Give the camera the EV100 with which `image` shows the picture, if nobody has set one."""
        if not self.camera.has_exposure:
            radiance = self["radiance"]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                factor = self._exposure_factor(radiance, None, self._renderer.tonemap)
            # The inverse of exposure_of.
            self.camera.ev100 = -math.log2(1.2 * factor)

    def show(self) -> None:
        """Show the picture below a notebook's cell, or in the desktop's program for it. Raises SolariError where there
        is none."""
        if "ipykernel" in sys.modules:
            display = importlib.import_module("IPython.display").display
            display(self)
            return
        reason = why_no_desktop() or self._show_on_desktop()
        if reason:
            raise SolariError(f'RenderedFrame.show: {reason}; frame.save("picture.png") writes the picture')

    def _show_on_desktop(self) -> str:
        """Returns what went wrong, "" if nothing did: then the file stays, for the program that shows it."""
        folder = Path(tempfile.mkdtemp(prefix="solari_vk-"))
        shown = False
        try:
            self.save(folder / "picture.png")
            reason = open_on_desktop(folder / "picture.png")
            shown = not reason
        finally:
            if not shown:
                shutil.rmtree(folder, ignore_errors=True)
        return reason

    def _repr_png_(self) -> bytes:
        """The picture as notebooks show it: what `save` writes as a .png, without its warnings."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return png_bytes(self.image())

    def __repr__(self) -> str:
        width, height = self.size
        return f"<RenderedFrame {width}x{height} of {type(self._renderer).__name__}: {', '.join(self.keys())}>"

    @checked_keywords()
    def save(
        self,
        path: str | os.PathLike[str],
        layers: str | Sequence[str] = (),
        *,
        exposure: float | str | None = None,
        tonemap: str | None = None,
        transparent: bool = False,
    ) -> None:
        """Write the picture as a .png or .jpg, or radiance in cd/m^2 as an .exr, .npz or .npy.

        layers: the name of a further result, or several, which become channels of an .exr or arrays of an .npz,
        otherwise .npy files beside the picture.
        exposure and tonemap are those of `image`, for the .png or .jpg. transparent: show surfaces alone, in a .png
        with straight alpha, in an .exr with premultiplied alpha. Their share of a pixel is the alpha; the scene's light
        stays as it is. A studio's floor is a surface: `scene.backdrop.visible = False` hides it. Raises SolariError for
        an unknown name or suffix, and for a file that can't be written.
        """
        renderer = self._renderer
        if isinstance(layers, str):
            layers = (layers,)
        curve = tonemap or renderer.tonemap
        if transparent:
            check_alpha(Path(path))
            if renderer.view != "picture":
                raise SolariError(f"{path}: a debug view has no transparent background: set view to 'picture'")
        is_picture = Path(path).suffix.lower() in EIGHT_BIT
        if is_picture and renderer.view != "picture":
            read = {name: self[name] for name in layers}  # before anything is written, which an error would leave
            write_codes(followed(Path(path)), self["display"][..., :3])
            write_beside(Path(path), read)
            return
        radiance = self["radiance"]
        if is_picture or isinstance(exposure, str):
            factor = self._exposure_factor(radiance, exposure, curve)
        else:  # files of radiance have an exposure for programs that show them, and are never metered
            factor = self.camera.exposure if exposure is None else exposure
        if is_picture:
            _warn_of_the_name(Path(path), layers)
        alpha = None
        if transparent:
            renderer.check_latest(self, "transparent")
            radiance, alpha = renderer.cut_out(radiance)
        save_image(
            path,
            radiance,
            alpha=alpha,
            exposure=factor,
            tonemap=curve,
            layers={name: self[name] for name in layers if name != "radiance"},
        )


def _warn_of_the_name(path: Path, layers: Sequence[str]) -> None:
    """Warn where a picture is called as one of its layers, which somebody may take it for."""
    name = path.stem
    if name in layers:
        warn(
            f"{path} is the picture in color; {name} is in {name}.{name}.npy beside it. Pictures of numbers "
            "are debug views of the realtime renderer: set its view"
        )
