"""Small scenes described in numpy, their acceleration structures (fresh, rebuilt, refitted or compacted), and rays
through these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.bound.spatial_order import spatial_order
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import AabbGeometry, Geometry, TriangleGeometry
from solari_vk.gpu.acceleration.structure import UpdateMode
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE, Tlas
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import HitGroup, Pass, RayPass
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Instance, Material, Mesh, Scene

FRESH = "fresh"
REBUILT = "rebuilt"
REFITTED = "refitted"
COMPACTED = "compacted"
BUILD_MODES = (FRESH, REBUILT, REFITTED, COMPACTED)
IDENTITY = np.eye(4)[:3]

_TRACE = "passes/conformance/trace"
_HITS = [HitGroup(f"{_TRACE}.rchit"), HitGroup(f"{_TRACE}.rchit", intersection=f"{_TRACE}.rint")]

# VkGeometryInstanceFlagBitsKHR
CULL_DISABLE = 1
FLIP_FACING = 2
INSTANCE_OPAQUE = 4
INSTANCE_NO_OPAQUE = 8


@dataclass(frozen=True)
class Triangles:
    """Corners (T, 3, 3) of triangles, in object space once `transform` (3, 4) is applied.

    `index_dtype` asks for an index buffer of that type."""

    corners: NDArray[np.floating]
    opaque: bool = True
    transform: NDArray[np.floating] | None = None
    index_dtype: type[np.unsignedinteger] | None = None
    stride: int = 12

    @property
    def placed(self) -> NDArray[np.float64]:
        """The corners in object space, float64."""
        corners = np.asarray(self.corners, np.float32).astype(np.float64)
        matrix = IDENTITY if self.transform is None else np.asarray(self.transform, np.float32).astype(np.float64)
        return transform_points(matrix, corners)


@dataclass(frozen=True)
class Boxes:
    """Boxes whose bounds (B, 2, 3) are their min and max corners in object space."""

    bounds: NDArray[np.floating]
    opaque: bool = False
    stride: int = 24


@dataclass(frozen=True)
class Placement:
    """An instance: its shape, its object-to-world matrix (3, 4), and the other fields of its record."""

    shape: str
    transform: NDArray[np.floating] = field(default_factory=lambda: IDENTITY)
    custom: int = 0
    mask: int = 0xFF
    flags: int = 0
    sbt_offset: int = 0
    active: bool = True

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The object-to-world matrix (3, 4) that the device gets: rounded to float32, then as float64."""
        return np.asarray(self.transform, np.float32).astype(np.float64)


Shapes = Mapping[str, Sequence[Triangles | Boxes]]
TRIANGLE_RECORD, BOX_RECORD = 0, 1
"""The hit records of ray pipelines: a device that traces by them needs those of a geometry's own kind."""


def record_of(parts: Sequence[Triangles | Boxes]) -> int:
    """TRIANGLE_RECORD or BOX_RECORD."""
    return BOX_RECORD if isinstance(parts[0], Boxes) else TRIANGLE_RECORD


def instance_records(placed: Sequence[Placement], addresses: Mapping[str, int]) -> np.ndarray:
    """The instances as INSTANCE_DTYPE records; `addresses` are those of the Blases by shape."""
    records = np.zeros(len(placed), INSTANCE_DTYPE)
    if placed:
        records["transform"] = [item.transform for item in placed]
        # Each of the next two words holds a field of 24 bits and one of 8, as VkAccelerationStructureInstanceKHR has
        # them.
        records["custom_index_and_mask"] = [item.custom | item.mask << 24 for item in placed]
        records["sbt_offset_and_flags"] = [item.sbt_offset | item.flags << 24 for item in placed]
        # Vulkan calls an instance without a structure inactive: no ray hits it.
        records["blas_address"] = [addresses[item.shape] if item.active else 0 for item in placed]
    return records


class Structures:
    """The structures of some shapes and instances in device memory, built in one of BUILD_MODES. A context
    manager.

    Structures that are rebuilt or refitted are first built with all vertices, boxes and instances moved elsewhere. On a
    device that traces by ray pipelines, instances get the record offset of their kind of geometry in place of their
    own, unless `own_records`. On one that traces by compute shaders, `tlas` is a RayTracer over shapes of one kind of
    triangles each, whose trees are built in one way. `damage` changes the instance records just before they are
    uploaded; tests of the suite seed bugs with it.
    """

    def __init__(
        self,
        device: Device,
        shapes: Shapes,
        placed: Sequence[Placement],
        build_mode: str = FRESH,
        *,
        fast_trace: bool = True,
        own_records: bool = False,
        damage: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        self.device = device
        self.placed = list(placed)
        self._open = ExitStack()
        if device.rays == "compute":
            self.tlas: Any = self._own_tracer(shapes, placed)
            return
        if device.rays == "pipeline" and not own_records:
            self.placed = [replace(item, sbt_offset=record_of(shapes[item.shape])) for item in placed]
        self._uploads: list[tuple[Buffer, np.ndarray]] = []
        self.sizes: dict[str, int] = {}  # sizes of Blases before compaction
        update = build_mode == REFITTED
        update_mode = UpdateMode.PREFER_UPDATE if update else UpdateMode.BUILD
        compact = build_mode == COMPACTED
        self.blases: dict[str, Blas] = {}
        for name, parts in shapes.items():
            blas = Blas(
                device,
                [self._geometry(part) for part in parts],
                prefer_fast_trace=fast_trace,
                update_mode=update_mode,
                allow_compaction=compact,
                name=name,
            )
            self.blases[name] = self._own(blas)
        self.tlas = self._own(Tlas(device, len(placed), update_mode=update_mode, prefer_fast_trace=fast_trace))
        self._instances = self._own(device.buffer(max(len(placed), 1) * INSTANCE_DTYPE.itemsize, "instances"))
        # Built elsewhere first, so that a build that changes nothing is found out.
        if build_mode in (REBUILT, REFITTED):
            self._build(displaced=True)
        self._build(update=update, compact=compact, damage=damage)

    def _own_tracer(self, shapes: Shapes, placed: Sequence[Placement]) -> Any:
        meshes = {}
        for name, parts in shapes.items():
            [part] = parts
            assert isinstance(part, Triangles)
            meshes[name] = Mesh(part.placed.reshape(-1, 3).astype(np.float32))
        scene, material = Scene(), Material()
        scene.origin = (0, 0, 0)  # so that the device has the same numbers
        for number, item in enumerate(placed):
            made = Instance(meshes[item.shape], material, item.matrix, visible=item.active and item.mask != 0)
            # What `trace` reads: the number among `placed`, and the custom data.
            made.name, made.label = str(number), str(item.custom)
            scene.add(made)
        return self._open.enter_context(RayTracer(self.device, scene))

    def _own(self, resource: Any) -> Any:
        self._open.callback(resource.destroy)
        return resource

    def _buffer(self, data: np.ndarray, name: str, moves: bool = True) -> Buffer:
        buffer: Buffer = self._own(self.device.buffer(data.nbytes, name))
        if moves:
            self._uploads.append((buffer, data))
        else:
            buffer.upload(data)
        return buffer

    def _geometry(self, part: Triangles | Boxes) -> Geometry:
        if isinstance(part, Boxes):
            data = _strided(np.asarray(part.bounds, np.float32).reshape(-1, 6), part.stride)
            boxes = self._buffer(data, "boxes")
            return AabbGeometry(
                boxes.address, len(part.bounds), part.stride, opaque=part.opaque, no_duplicate_any_hit=True
            )
        vertices = np.asarray(part.corners, np.float32).reshape(-1, 3)
        indices = 0
        if part.index_dtype is not None:
            # The vertex buffer is shuffled, so that a driver that ignores the indices is found out.
            order = np.random.default_rng(5).permutation(len(vertices))
            inverse = np.empty_like(order)
            inverse[order] = np.arange(len(order))
            vertices = vertices[order]
            indices = self._buffer(inverse.astype(part.index_dtype), "indices", moves=False).address
        transform = 0
        if part.transform is not None:
            matrix = np.asarray(part.transform, np.float32)
            transform = self._buffer(matrix, "geometry transform", moves=False).address
        positions = self._buffer(_strided(vertices, part.stride), "positions")
        return TriangleGeometry(
            positions.address,
            len(vertices),
            len(part.corners),
            indices=indices,
            index_dtype=part.index_dtype or np.uint32,
            position_stride=part.stride,
            transform=transform,
            opaque=part.opaque,
            no_duplicate_any_hit=True,
        )

    def _build(
        self,
        *,
        displaced: bool = False,
        update: bool = False,
        compact: bool = False,
        damage: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        with self.device.uploads() as uploads:
            for buffer, data in self._uploads:
                # The displaced vertices keep the triangles alive: degenerate ones may never become active by a refit.
                uploads.buffer(buffer, data * np.float32(1.5) + np.float32(7) if displaced else data)
        build_blases(self.device, list(self.blases.values()), compact=False, update=update)
        if compact:
            self._compact()
        records = instance_records(self.placed, {name: blas.address for name, blas in self.blases.items()})
        if displaced:
            records["transform"][:, :, 3] += np.float32(-31)
        if damage is not None:
            damage(records)
        self.place(records, update=update)

    def _compact(self) -> None:
        """Replace all Blases by compacted copies."""
        for blas in self.blases.values():
            blas.prepare_compaction()
        self.device.wait_idle()
        self.sizes = {name: blas.size for name, blas in self.blases.items()}
        for name, blas in self.blases.items():
            self.blases[name] = self._own(blas.compact())
            blas.destroy()

    def place(self, records: np.ndarray, *, update: bool = False) -> None:
        """Build the TLAS over these records, or refit it."""
        if len(records):
            self._instances.upload(records)
        address = self._instances.address
        self.device.run(lambda cmd: self.tlas.record_build(cmd, address, len(records), update=update), "tlas")

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        self._open.close()

    def __enter__(self) -> Structures:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _strided(rows: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Rows `stride` bytes apart. The gaps hold NaN, so that a driver that reads them is found out."""
    data = np.full((len(rows), stride // 4), np.nan, np.float32)
    data[:, : rows.shape[1]] = rows
    return data


def translation(x: float, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """A translation matrix (3, 4)."""
    matrix = IDENTITY.copy()
    matrix[:, 3] = x, y, z
    return matrix


def trace(
    shaders: ShaderRunner,
    tlas: Tlas | RayTracer,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: ArrayLike = 0.0,
    t_max: ArrayLike = 1e30,
    flags: int = 0,
    cull_mask: int = 0xFF,
    box_t: float = 0.0,
) -> np.ndarray:
    """The closest hits of N rays: records of t, custom_data, instance, geometry and primitive; t < 0 is a miss.

    Boxes are hit at `box_t`, or ignored when it is 0.
    """
    origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
    if isinstance(tlas, RayTracer):
        return _hits_of(shaders, tlas, tlas.trace(origins, directions, t_min=t_min, t_max=t_max))
    rays = np.zeros(len(origins), shaders.element("conformance/trace", "rays"))
    rays["origin"] = origins
    rays["direction"] = directions
    rays["t_min"] = t_min
    rays["t_max"] = t_max
    rays["flags"] = flags
    rays["cull_mask"] = cull_mask
    rays["box_t"] = box_t
    step = Pass("conformance/trace", threads=len(rays))
    if shaders.device.rays == "pipeline":
        step = RayPass(step.name, threads=len(rays), misses=[f"{_TRACE}.rmiss"], hits=_HITS)
    return shaders.run_steps([step], {"tlas": tlas, "rays": rays}, {"hits": len(rays)})["hits"]


def _hits_of(shaders: ShaderRunner, tracer: RayTracer, found: np.ndarray) -> np.ndarray:
    """What a RayTracer of `Structures` has found, as the suite's shaders tell it."""
    numbers = np.zeros((max(tracer.instances, default=0) + 1, 2), np.uint32)
    for number, instance in tracer.instances.items():
        numbers[number] = int(instance.name), int(instance.label)
    hits = np.zeros(len(found), shaders.element("conformance/trace", "hits"))
    hits["t"] = np.where(found["instance"] < 0, -1, found["t"])
    hits["instance"], hits["custom_data"] = numbers[found["instance"]].T
    hits["primitive"] = found["primitive"].astype(np.uint32)
    return hits


def build_and_trace(
    shaders: ShaderRunner,
    shapes: Shapes,
    placed: Sequence[Placement],
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    damage: Callable[[np.ndarray], None] | None = None,
    box_t: float = 0.0,
) -> np.ndarray:
    """`trace` through structures that are built for it; see `Structures`."""
    with Structures(shaders.device, shapes, placed, damage=damage) as structures:
        return trace(shaders, structures.tlas, origins, directions, box_t=box_t)


def random_rotation(random: np.random.Generator) -> NDArray[np.float64]:
    """A random rotation (3, 3)."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    # Makes the decomposition unique, so rotations are uniform (Mezzadri 2007); the last line removes reflections.
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))  # type: ignore[no-any-return]


def bumpy_ball(segments: int, bumps: float, seed: int = 0) -> NDArray[np.float32]:
    """About 2 * segments^2 thin, uneven triangles (T, 3, 3), in spatial order, that close a ball around the origin."""
    random = np.random.default_rng(seed)
    rings = segments
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.arange(segments) * (2 * np.pi / segments), indexing="ij"
    )
    radius = 1 + bumps * np.sin(polar) * random.uniform(-1, 1, polar.shape)
    sine = np.sin(polar)
    # The sine of pi is not 0 in floats: at the poles all points of a ring must be the same.
    sine[[0, -1]] = 0
    points = np.stack([sine * np.cos(around), np.cos(polar), sine * np.sin(around)], -1) * radius[..., None]
    points = points.astype(np.float32)
    a, b = points[:-1], points[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    # Two triangles for each quad between two rings.
    corners = np.concatenate([np.stack([a, c, b], 2).reshape(-1, 3, 3), np.stack([a, d, c], 2).reshape(-1, 3, 3)])
    # Quads at the poles have one triangle without area.
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    corners = corners[area > 0]
    ordered: NDArray[np.float32] = corners[spatial_order(corners.min(axis=1), corners.max(axis=1))]
    return ordered
