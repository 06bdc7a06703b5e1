"""Arrays of rays through a scene, and what each ray hits."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import Hints, SolariError, checked_keywords, unknown_attribute
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.triangle_orders import TriangleOrders
from solari_vk.gpu.acceleration.checks import check_switch, numbers, whole_number
from solari_vk.gpu.device.barriers import host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Pass, Stage, Step
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import brdf_table
from solari_vk.renderers.scene_frame import SceneFrame, bind_scene
from solari_vk.scene.model import Instance, Scene

SHADER = "passes/ray_tracer/trace.comp"
ECHO_SHADER = "passes/ray_tracer/backscatter.comp"
ARRAYS = ("ray_origins", "ray_directions", "ray_starts", "ray_ends", "ray_hits")
ECHOES = "ray_echoes"
BATCH = 1 << 16  # rays in a dispatch: enough to hide the cost of a dispatch, few enough for any driver's watchdog


class Hits(np.recarray[Any, Any]):
    """Records of hits or echoes, whose fields are attributes too."""

    if not TYPE_CHECKING:  # or checkers would take any name

        def __getattr__(self, name: str) -> NoReturn:
            raise unknown_attribute("hits have no field", name, lambda: self.dtype.names or ())


class RayTracer(Hints):
    """Traces arrays of rays through a scene. A context manager.

    The scene may be edited between calls. `instances` has the Instance objects by the numbers in hits. Rays hit an
    instance's ray_mesh where it has one, and pass through invisible instances.
    """

    @checked_keywords()
    def __init__(self, device: Device, scene: Scene | SceneBinder) -> None:
        self.device = device
        self._owned = ExitStack()
        self.binder = bind_scene(device, scene, type(self).__name__, self._owned)
        self._frames: dict[tuple[bool, bool], SceneFrame] = {}
        self._orders = TriangleOrders(device, self.binder)
        self._revision = -1
        self.instances: dict[int, Instance] = {}
        self._buffers: dict[str, Buffer] = {}
        self._mapped: dict[str, NDArray[Any]] = {}
        try:
            self._make_buffers(SHADER, ARRAYS)
        except BaseException:
            self.close()
            raise

    def _make_buffers(self, shader: str, names: tuple[str, ...]) -> None:
        bindings = reflect(compile_shader(shader), shader).bindings
        for name in names:
            dtype = _host_type(bindings[name].element)
            self._buffers[name] = self.device.buffer(2 * BATCH * dtype.itemsize, name, host=True)
            self._mapped[name] = self._buffers[name].view(dtype)

    def trace(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        any_hit: bool = False,
        seed: int = 0,
    ) -> Hits:
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
        check_switch(any_hit, "trace: any_hit")
        if whole_number(seed, "trace: seed", 0) >= 1 << 32:
            raise SolariError(f"trace: seed is {seed}: give a whole number below 2^32")
        shape, rays = _broadcast("trace", origins, directions, t_min, t_max)
        (hits,) = self._run("trace", rays, any_hit, seed, ("ray_hits",))
        return hits.reshape(shape).view(Hits)

    def backscatter(
        self, origins: ArrayLike, directions: ArrayLike, *, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf
    ) -> tuple[Hits, Hits]:
        """The nearest hit of each ray, and what becomes there of light that comes along the ray, as lidars and other
        sensors with a light of their own see it.

        Arguments and hits are those of `trace`, but rays hit blended surfaces and panes of glass always. Echoes are
        records (...) with the fields backscatter (3), the BRDF towards where the ray comes from times the cosine, in
        1/sr (a mirror's is 0), and passed (3), the share of light that goes straight on: through blended surfaces,
        walls of glass, and into or out of solid glass, which doesn't refract it here.
        """
        shape, rays = _broadcast("backscatter", origins, directions, t_min, t_max)
        hits, echoes = self._run("backscatter", rays, False, 0, ("ray_hits", ECHOES))
        return hits.reshape(shape).view(Hits), echoes.reshape(shape).view(Hits)

    def _run(
        self, who: str, rays: dict[str, NDArray[Any]], any_hit: bool, seed: int, outputs: tuple[str, ...]
    ) -> list[NDArray[Any]]:
        """The outputs (N) of rays, traced in batches."""
        if not self._buffers:
            raise SolariError(f"RayTracer.{who}: the ray tracer is closed; make a new one")
        self.device.check_open()
        self._update()
        if self.binder.origin.any():
            rays = rays | {"ray_origins": rays["ray_origins"] - self.binder.origin}
        frame = self.frame(any_hit, ECHOES in outputs)
        frame.uniforms["ray_batch.seed"] = seed
        count = len(rays["ray_origins"])
        found = [np.empty(count, self._mapped[name].dtype) for name in outputs]
        pending: tuple[int, slice, slice] | None = None

        def fetch(value: int, batch: slice, span: slice) -> None:
            self.device.await_value(value)
            for name, values in zip(outputs, found, strict=True):
                # as bytes: numpy copies records field by field
                values[batch].view(np.uint8)[:] = self._mapped[name][span].view(np.uint8)

        for number, start in enumerate(range(0, count, BATCH)):
            batch = slice(start, min(start + BATCH, count))
            # The buffers have two halves: the host fills and reads one while the device works on the other.
            first = number % 2 * BATCH
            span = slice(first, first + batch.stop - batch.start)
            with np.errstate(over="ignore"):  # overflow gives infinity, as documented
                for name, values in rays.items():
                    self._mapped[name][span] = values[batch]
            frame.uniforms["ray_batch.first"] = first
            # Random numbers follow from a ray's number in the whole array, so that batches don't repeat them.
            frame.uniforms["ray_batch.number"] = start & 0xFFFFFFFF
            frame.uniforms["ray_batch.count"] = batch.stop - batch.start
            submitted = (frame.submit(), batch, span)
            if pending is not None:  # fetch a batch while the next one is traced
                fetch(*pending)
            pending = submitted
        if pending is not None:
            fetch(*pending)
        return found

    def frame(self, any_hit: bool, echoes: bool = False) -> SceneFrame:
        """The frame that traces a batch of the rays in the buffers."""
        if (any_hit, echoes) not in self._frames:  # each variant is compiled when it is first asked for
            vk = self.device.vk
            external: dict[str, Any] = {**self._buffers, **self._orders.buffers}
            if echoes:
                table, tables = brdf_table.compute(self.device)
                self._owned.enter_context(table)
                self._make_buffers(ECHO_SHADER, (ECHOES,))
                external |= {ECHOES: self._buffers[ECHOES], **tables}
            name = "ray_tracer/backscatter" if echoes else "ray_tracer/trace"
            trace = Pass(name, threads=BATCH, constants={"any_hit": any_hit})
            # The host reads the hits where they are: a barrier makes them visible to it.
            to_host = Step("hits to the host", lambda cmd: vk.vkCmdPipelineBarrier2(cmd, host_read_barrier()))
            stage = Stage("ray tracer", passes=[trace, to_host])
            frame = SceneFrame(self.device, self.binder, [stage], external=external)
            self._frames[any_hit, echoes] = frame
        return self._frames[any_hit, echoes]

    @property
    def hides_back(self) -> NDArray[np.bool_]:
        """Whether cameras look through the back of each instance, by its number, as of the latest trace."""
        table = np.zeros(max(self.instances, default=0) + 1, np.bool_)
        for number, instance in self.instances.items():
            table[number] = instance.material.hides_back
        return table

    def _update(self) -> None:
        """Apply the scene's edits to `instances` and to the order of triangles on the device."""
        self.binder.update()
        if self.binder.scene_revision == self._revision:
            return  # no edit since the latest call
        self.instances = self.binder.instances
        if self._orders.update():
            for frame in self._frames.values():
                frame.bind(self._orders.buffers)
        self._revision = self.binder.scene_revision

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
        self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _host_type(element: Any) -> np.dtype[Any]:
    """A shader's type as users see it: indices are signed, so that -1 means none, and front_face is a bool."""
    if element.names is None:
        return np.dtype((element.base, element.shape))
    # The shader's 2^32 - 1 for "none" is -1 in the same bits, and its 0 or 1 is a bool in the lowest byte.
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
    who: str, origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[tuple[int, ...], dict[str, NDArray[Any]]]:
    """The shape of the rays, and the shader's inputs as arrays (N, 3) and (N)."""
    arguments = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}
    arrays = {name: numbers(values, f"{who}: {name}") for name, values in arguments.items()}
    for name in ("origins", "directions"):
        if arrays[name].shape[-1:] != (3,):
            raise SolariError(f"{who}: the shape of {name} is {arrays[name].shape}, not (..., 3)")
    try:
        shapes = [arrays["origins"].shape[:-1], arrays["directions"].shape[:-1]]
        shape = np.broadcast_shapes(*shapes, arrays["t_min"].shape, arrays["t_max"].shape)
    except ValueError as error:
        raise SolariError(f"{who}: {', '.join(f'{n} {a.shape}' for n, a in arrays.items())} don't fit") from error
    vectors = (np.broadcast_to(arrays[name], (*shape, 3)).reshape(-1, 3) for name in ("origins", "directions"))
    scalars = (np.broadcast_to(arrays[name], shape).reshape(-1) for name in ("t_min", "t_max"))
    return shape, dict(zip(ARRAYS, (*vectors, *scalars), strict=False))
