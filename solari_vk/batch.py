"""Many cameras of one scene in one frame: first hits, or pictures of the reference path tracer."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.bound import view_table
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.features import LENSES
from solari_vk.bound.triangle_orders import TriangleOrders
from solari_vk.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.frame import SceneFrame, SceneUser
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_tensor import CudaTensor
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import batch as passes
from solari_vk.passes import pathtracer
from solari_vk.reference import PathTracer, numbered_seeds
from solari_vk.scene.model import Camera, Instance, Scene

RENDERERS = ("labels", "reference")
SHADER = "passes/batch/labels.comp"
PATH_OPTIONS = [field.name for field in dataclasses.fields(pathtracer.Settings)]


class Batch(SceneUser):
    """Renders many views of a scene in one frame. A context manager.

    size: (width, height) of a view in pixels. views: their number N. renderer: "labels" finds first hits alone, at the
    pixels' centers; "reference" adds path-traced `radiance`, and takes the options of `PathTracer`, such as seed and
    max_bounces. outputs: names of OUTPUTS, which are computed beside the radiance: by default depth, position,
    geometric_normal, instance_id and primitive; motion_vectors and what needs materials take time of their own. View i
    has what a `PathTracer` of its own finds with the same camera and seed, bit by bit or, where a driver rounds in
    another way, nearly so: seed i is `seed` + i * 0x9E3779B9 modulo 2^32. Rays hit an instance's ray_mesh where it has
    one.

    The scene may be edited between calls of `render`. Raises SolariError for wrong options, and for more views than the
    device's buffers hold, which names the largest number.
    """

    OUTPUTS = passes.OUTPUTS

    def __init__(
        self, device: Device, scene: Scene | SceneBinder, size: tuple[int, int], views: int, *,
        renderer: str = "labels", outputs: Sequence[str] = passes.GEOMETRY, **options: Any,
    ) -> None:  # fmt: skip
        if renderer not in RENDERERS:
            raise SolariError(f"Batch: renderer is one of {', '.join(RENDERERS)}, not {quoted(renderer)}")
        for name in options:
            if name not in PATH_OPTIONS or renderer == "labels":
                known = ["renderer", "outputs", *(PATH_OPTIONS if renderer == "reference" else ())]
                raise unknown_name(f"Batch with renderer='{renderer}' has no option", name, known)
        if not isinstance(outputs, (str, Sequence)):
            raise SolariError(f"Batch: outputs is a list of names, not {quoted(outputs)}")
        given = [outputs] if isinstance(outputs, str) else list(outputs)
        for name in given:
            if name not in passes.OUTPUTS:
                raise unknown_name("Batch: there is no output", name, passes.OUTPUTS)
        names = tuple(dict.fromkeys(given))
        if renderer == "labels" and not names:
            raise SolariError(f"Batch: outputs names nothing: give some of {', '.join(passes.OUTPUTS)}")
        super().__init__(device, scene)
        try:
            self.views = whole_number(views, "Batch: views", 1)
            record = reflect(compile_shader(SHADER), SHADER).bindings["views"].element
            assert record is not None
            self._record: np.dtype[Any] = record
            self.size = _checked_size(device, size, self.views, record.itemsize)
            self._strip = self.size[0], self.size[1] * self.views
            self._rows = pathtracer.max_rows(self._strip)
            self._names = ("radiance", *names) if renderer == "reference" else names
            self._latest: NDArray[Any] | None = None  # the views of the latest frame
            self._closed = False
            self._tensors = 0  # that somebody has
            self._buffer = device.buffer(self.views * record.itemsize, "views")
            self._owned.callback(self._buffer.destroy)
            self.binder.update()
            self._capacity = self.binder.instance_capacity
            self._labels: SceneFrame | None = None
            if names:
                self._orders = TriangleOrders(device, self.binder)
                self._owned.callback(self._orders.destroy)
                self._orders.update()
                external = {"views": self._buffer, **self._orders.buffers}
                frame = SceneFrame(device, self.binder, self._stages(), external=external)
                self._labels = self._owned.enter_context(frame)
            self._paths: _ViewTracer | None = None
            if renderer == "reference":
                self._paths = _ViewTracer(device, self.binder, self._strip, self._buffer, options)
                self._owned.callback(self._paths.close)
        except BaseException:
            self._owned.close()
            raise

    def _stages(self) -> list[Stage]:
        return [passes.labels_stage(self._strip, self._rows, self._names, self._capacity)]

    # ---- rendering ----------------------------------------------------------------------------------

    @checked_keywords()
    def render(
        self, cameras: ArrayLike | Sequence[Camera], *, fov: ArrayLike | None = None,
        vertical_fov: ArrayLike | None = None, K: ArrayLike | None = None, near: ArrayLike | None = None,
        samples: int | None = None, seeds: ArrayLike | None = None, reset: ArrayLike = False,
    ) -> Self:  # fmt: skip
        """Render all views, and return the batch, whose results are these until it renders again.

        cameras: poses (N, 4, 4), the transforms of `Camera`: world from camera, which looks along its -z axis with y
        up, in meters. They are arrays of numpy or tensors in host memory. Their lens is given by one of fov, the
        vertical field of view in degrees, vertical_fov, in radians (45 degrees), both a number or (N,), and K, OpenCV's
        matrices (3, 3) or (N, 3, 3) in pixels of a view, as `Camera.from_opencv` takes them; near, a number or (N,), is
        Camera.near. Or N `Camera` objects of any kind, with lenses, apertures and parallel projections.

        samples: per pixel, by default 16; each call begins new pictures. seeds (N,): whole numbers for those of the
        views. reset: True or (N,), views that begin anew: their cameras count as not having moved. Does not wait for
        the device. Raises SolariError for wrong shapes, numbers that aren't finite, and matrices that can't be
        inverted; nothing is rendered then.
        """
        self._check_open()
        samples = self._checked_samples(samples)
        views = np.zeros(self.views, self._record)
        current = np.zeros(self.views, self._record["current"])
        options = {"fov": fov, "vertical_fov": vertical_fov, "K": K, "near": near}
        lenses = view_table.write(current, cameras, self.size, options)
        views["current"], views["seed"] = current, self._checked_seeds(seeds)
        cut = np.broadcast_to(_checked_mask(reset, self.views), self.views)
        views["previous"] = current if self._latest is None else np.where(cut, current, self._latest)
        if lenses and LENSES not in self.binder.features:
            self.binder.note(lenses[0])
        self._buffer.upload(views)
        if self._labels is not None:
            self._find_labels(self._labels)
        self._latest = current
        if self._paths is not None:
            self._paths.trace(samples)
        return self

    def _find_labels(self, frame: SceneFrame) -> None:
        binder = self.binder
        frame.apply_edits()
        if self._orders.update():
            frame.bind(self._orders.buffers)
        if binder.instance_capacity != self._capacity:
            self._capacity = binder.instance_capacity
            if "motion_vectors" in self._names:
                previous = frame.resource("previous_instances").read()  # whose rows stay valid
                frame.rebuild(self._stages())
                frame.resource("previous_instances").upload(previous)
        frame.uniforms["path_sampling.row_count"] = self._rows
        for row in range(0, self._strip[1], self._rows):
            frame.uniforms["path_sampling.first_row"] = row
            frame.submit_applied()

    # ---- results ------------------------------------------------------------------------------------

    def keys(self) -> list[str]:
        """The names of the results."""
        return list(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A copy of a result of the latest frame, (N, height, width[, channels]). Waits for the frame."""
        frame, resource = self._place(name)
        read: NDArray[Any] = self._shaped(name, frame[resource])
        return read

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        """A result of the latest frame that stays on the device, (N, height, width[, channels]).

        On software devices, and others whose memory the host sees, it is an array in the device's own memory, without a
        copy. It waits for the frame, and shows later frames too: take it again after each `render`, which waits. On
        NVIDIA devices it is a copy on the device that later frames don't change, without waiting, for CUDA: see
        `RenderedFrame.tensor`. Both, and what `torch.from_dlpack` and others make of them, keep their memory when the
        batch and the device are closed. Raises SolariError, with the reason, where the device can't share its memory.
        """
        frame, resource = self._place(name)
        buffer: Buffer = frame.resource(resource)
        tensor: NDArray[Any] | CudaTensor
        if not buffer.mapped:
            tensor = self._shaped(name, frame.tensor(resource))
            return tensor
        element = frame.binding(resource).element
        assert element is not None
        self.device.sync_host()
        memory = buffer.view(element.base, self._strip[0] * self._strip[1] * math.prod(element.shape))
        self._tensors += 1
        self.device.lent.lend(memory, self._release_tensor)
        tensor = self._shaped(name, memory)
        return tensor

    def _release_tensor(self) -> None:
        """A tensor, and all that was made of it, is gone."""
        self._tensors -= 1
        if self._closed:
            self.close()

    def _place(self, name: str) -> tuple[SceneFrame, str]:
        """The frame that has a result, and the name of its buffer."""
        self._check_open()
        if name not in self._names:
            raise unknown_name("Batch: there is no result", name, self._names)
        if self._latest is None:
            raise SolariError(f"Batch: render before asking for '{name}'")
        if name == "radiance":
            assert self._paths is not None
            return self._paths.frame, "radiance_mean"
        assert self._labels is not None
        return self._labels, f"aov_{name}"

    def _shaped(self, name: str, values: Any) -> Any:
        if name == "primitive" and isinstance(values, np.ndarray):
            values = values.view(np.int32)  # -1 for none, as hits of RayTracer have it
        channels = math.prod(values.shape) // (self._strip[0] * self._strip[1])
        return values.reshape(self.views, self.size[1], self.size[0], *((channels,) if channels > 1 else ()))

    @property
    def instances(self) -> dict[int, Instance]:
        """The scene's instances by the numbers in `batch["instance_id"]`."""
        return self.binder.instances

    def close(self) -> None:
        """Free everything on the device, when no tensor needs it any more. Safe to call twice."""
        self._closed = True
        if not self._tensors:
            super().close()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<Batch of {self.views} views {width}x{height} on {self.device.name}: {', '.join(self._names)}>"

    # ---- checks -------------------------------------------------------------------------------------

    def _check_open(self) -> None:
        if self._closed:
            raise SolariError("nothing can be rendered or read: the batch was closed; make a new one")

    def _checked_samples(self, samples: int | None) -> int:
        if self._paths is None and samples is not None:
            raise SolariError("Batch.render: labels have no samples: make the batch with renderer='reference'")
        return whole_number(16 if samples is None else samples, "Batch.render: samples", 1)

    def _checked_seeds(self, seeds: Any) -> NDArray[Any]:
        if self._paths is None and seeds is not None:
            raise SolariError("Batch.render: labels have no seeds: make the batch with renderer='reference'")
        if seeds is None:
            return numbered_seeds(0 if self._paths is None else self._paths.seed, self.views)
        given = view_table.array(seeds, "seeds", (self.views,))
        whole = (given == np.floor(given)) & (given >= 0) & (given < 2**32)
        view_table.check_all(whole, "the seed", "be a whole number from 0 to 2^32 - 1")
        return given


class _ViewTracer(PathTracer):
    """The path tracer over a strip of views."""

    def __init__(
        self, device: Device, binder: SceneBinder, strip: tuple[int, int], views: Buffer, options: dict[str, Any]
    ) -> None:
        self._views = views
        super().__init__(device, binder, strip, **options)

    @property
    def frame(self) -> SceneFrame:
        return self._frame

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        return [pathtracer.trace_stage(size, self._band_rows, self.settings, "trace_views")]

    def _inputs(self) -> dict[str, Any]:
        return super()._inputs() | {"views": self._views}

    def trace(self, samples: int) -> None:
        """Trace new pictures with this many samples per pixel."""
        self._begin_picture()
        self._warn_of_darkness()
        pathtracer.write_uniforms(self._frame.uniforms, self.settings)
        while self.samples < samples:
            self._add_samples(min(self._batch, samples - self.samples))
            self._adapt()


def _checked_mask(reset: Any, views: int) -> NDArray[np.bool_]:
    try:
        mask = np.asarray(reset)
    except (TypeError, ValueError, RuntimeError):
        mask = np.zeros(0)
    if mask.dtype != np.bool_ or mask.shape not in ((), (views,)):
        raise SolariError(f"Batch.render: reset is True, False or an array ({views},) of these, not {quoted(reset)}")
    return mask


def _checked_size(device: Device, size: Any, views: int, record_bytes: int) -> tuple[int, int]:
    """The size of a view; raises SolariError if buffers don't hold so many views, with a record for each."""
    width, height = _pair(size)
    limit = device.properties.limits.maxStorageBufferRange
    pixels = width * height if width > 0 and height > 0 else 0
    most = min(limit // (pathtracer.LARGEST_PIXEL_BYTES * pixels), limit // record_bytes) if pixels else 0
    if views > most:
        hint = f"at most {most:,} views of this size: render them in parts" if most else "none of this size"
        raise SolariError(f"Batch: {views:,} views of {width}x{height} pixels: this device's buffers hold {hint}")
    return width, height


def _pair(size: Any) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise SolariError(f"Batch: size must be two whole numbers (width, height), not {quoted(size)}") from None
    return whole_number(width, "Batch: the width"), whole_number(height, "Batch: the height")
