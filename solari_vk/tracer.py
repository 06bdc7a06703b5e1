"""Arrays of rays through a scene, and what each ray hits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.triangle_orders import TriangleOrders
from solari_vk.errors import SolariError, checked_keywords, unknown_attribute
from solari_vk.frame import SceneFrame, SceneUser
from solari_vk.gpu.acceleration.checks import check_switch, numbers, whole_number
from solari_vk.gpu.device.barriers import host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Pass, Stage, Step
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.scene.model import Instance, Scene

SHADER = "passes/ray_tracer/trace.comp"
ARRAYS = ("ray_origins", "ray_directions", "ray_starts", "ray_ends", "ray_hits")
BATCH = 1 << 16  # rays in a dispatch: enough to hide the cost of a dispatch, few enough for any driver's watchdog


class Hits(np.recarray[Any, Any]):
    """Records of hits, whose fields are attributes too."""

    if not TYPE_CHECKING:  # or checkers would take any name

        def __getattr__(self, name: str) -> NoReturn:
            raise unknown_attribute("hits have no field", name, lambda: self.dtype.names or ())


class RayTracer(SceneUser):
    """Traces arrays of rays through a scene. A context manager.

    The scene may be edited between calls. `instances` has the Instance objects by the numbers in hits. Rays hit an
    instance's ray_mesh where it has one, and pass through invisible instances.
    """

    @checked_keywords()
    def __init__(self, device: Device, scene: Scene | SceneBinder) -> None:
        super().__init__(device, scene)
        self._frames: dict[bool, SceneFrame] = {}
        self._orders = TriangleOrders(device, self.binder)
        self._revision = -1
        self.instances: dict[int, Instance] = {}
        self._buffers: dict[str, Buffer] = {}
        self._mapped: dict[str, NDArray[Any]] = {}
        try:
            bindings = reflect(compile_shader(SHADER), SHADER).bindings
            for name in ARRAYS:
                dtype = _host_type(bindings[name].element)
                self._buffers[name] = device.buffer(2 * BATCH * dtype.itemsize, name, host=True)
                self._mapped[name] = self._buffers[name].view(dtype)
        except BaseException:
            self.close()
            raise

    def trace(
        self, origins: ArrayLike, directions: ArrayLike, *, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf,
        any_hit: bool = False, seed: int = 0,
    ) -> Hits:  # fmt: skip
        """The nearest hit of each ray.

        origins (..., 3) are in meters; directions (..., 3) may have any length. t_min and t_max (...) bound the ray, in
        multiples of its direction. All four are broadcast against each other and converted to float32, where values
        beyond the range become infinite. any_hit: return any hit instead of the nearest, which is faster if only
        occlusion matters. A ray with a NaN, an infinite origin or direction, a direction of zero length or a negative
        t_min hits nothing. Rays hit a blended surface with the probability alpha. The seed of these random numbers is a
        whole number from 0 to 2^32 - 1: the same seed and rays give the same hits, another seed independent ones.

        Returns records (...), hits.t or hits["t"], with the fields t (inf without a hit), instance (a key of
        `instances`, -1 without a hit), primitive (the index of the triangle in the ray_mesh or mesh, -1 without a hit),
        barycentrics (2) of the second and third vertex, front_face, position (3) in meters, and normal (3), the
        triangle's unit normal on its front side. Raises SolariError for arrays whose shapes don't fit each other, and
        for another seed.
        """
        if not self._buffers:
            raise SolariError("RayTracer.trace: the ray tracer is closed; make a new one")
        check_switch(any_hit, "trace: any_hit")
        if whole_number(seed, "trace: seed", 0) >= 1 << 32:
            raise SolariError(f"trace: seed is {seed}: give a whole number below 2^32")
        shape, rays = _broadcast(origins, directions, t_min, t_max)
        self._update()
        frame = self.frame(any_hit)
        frame.uniforms["ray_batch.seed"] = seed
        count = len(rays["ray_origins"])
        hits = np.empty(count, self._mapped["ray_hits"].dtype)
        pending: tuple[int, slice, slice] | None = None
        for number, start in enumerate(range(0, count, BATCH)):
            batch = slice(start, min(start + BATCH, count))
            first = number % 2 * BATCH
            span = slice(first, first + batch.stop - batch.start)
            with np.errstate(over="ignore"):  # overflow gives infinity, as documented
                for name, values in rays.items():
                    self._mapped[name][span] = values[batch]
            frame.uniforms["ray_batch.first"] = first
            frame.uniforms["ray_batch.number"] = start & 0xFFFFFFFF
            frame.uniforms["ray_batch.count"] = batch.stop - batch.start
            submitted = (frame.submit(), batch, span)
            if pending is not None:  # fetch a batch while the next one is traced
                self._fetch(hits, *pending)
            pending = submitted
        if pending is not None:
            self._fetch(hits, *pending)
        return hits.reshape(shape).view(Hits)

    def _fetch(self, hits: NDArray[Any], value: int, batch: slice, span: slice) -> None:
        self.device.await_value(value)
        # as bytes: numpy copies records field by field
        hits[batch].view(np.uint8)[:] = self._mapped["ray_hits"][span].view(np.uint8)

    def frame(self, any_hit: bool) -> SceneFrame:
        """The frame that traces a batch of the rays in the buffers."""
        if any_hit not in self._frames:
            vk = self.device.vk
            trace = Pass("ray_tracer/trace", threads=BATCH, constants={"any_hit": any_hit})
            to_host = Step("hits to the host", lambda cmd: vk.vkCmdPipelineBarrier2(cmd, host_read_barrier()))
            stage = Stage("ray tracer", passes=[trace, to_host])
            self._frames[any_hit] = SceneFrame(
                self.device, self.binder, [stage], external={**self._buffers, **self._orders.buffers}
            )  # fmt: skip
        return self._frames[any_hit]

    def _update(self) -> None:
        """Apply the scene's edits to `instances` and to the order of triangles on the device."""
        self.binder.update()
        if self.binder.revision == self._revision:
            return
        self.instances = self.binder.instances
        if self._orders.update():
            for frame in self._frames.values():
                frame.bind(self._orders.buffers)
        self._revision = self.binder.revision

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        for frame in self._frames.values():
            frame.close()
        for buffer in self._buffers.values():
            buffer.destroy()
        self._frames.clear()
        self._buffers.clear()
        self._orders.destroy()
        self._mapped.clear()
        super().close()


def _host_type(element: Any) -> np.dtype[Any]:
    """A shader's type as users see it: indices are signed, so that -1 means none, and front_face is a bool."""
    if element.names is None:
        return np.dtype((element.base, element.shape))
    types = {"instance": "<i4", "primitive": "<i4", "front_face": "?"}
    fields = element.fields
    described: np.dtype[Any] = np.dtype(
        {
            "names": list(element.names),
            "formats": [types.get(name, fields[name][0]) for name in element.names],
            "offsets": [fields[name][1] for name in element.names],
            "itemsize": element.itemsize,
        }
    )
    return described


def _broadcast(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[tuple[int, ...], dict[str, NDArray[Any]]]:
    """The shape of the rays, and the shader's inputs as arrays (N, 3) and (N)."""
    given = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}
    arrays = {name: numbers(values, f"trace: {name}") for name, values in given.items()}
    for name in ("origins", "directions"):
        if arrays[name].shape[-1:] != (3,):
            raise SolariError(f"trace: the shape of {name} is {arrays[name].shape}, not (..., 3)")
    try:
        shapes = [arrays["origins"].shape[:-1], arrays["directions"].shape[:-1]]
        shape = np.broadcast_shapes(*shapes, arrays["t_min"].shape, arrays["t_max"].shape)
    except ValueError as error:
        raise SolariError(f"trace: {', '.join(f'{n} {a.shape}' for n, a in arrays.items())} don't fit") from error
    vectors = (np.broadcast_to(arrays[name], (*shape, 3)).reshape(-1, 3) for name in ("origins", "directions"))
    scalars = (np.broadcast_to(arrays[name], shape).reshape(-1) for name in ("t_min", "t_max"))
    return shape, dict(zip(ARRAYS, (*vectors, *scalars), strict=False))
