"""The records of a batch's views for shaders with MANY_VIEWS: struct View of glsl/scene/camera_block.glsl.

Arrays of poses become records without a loop over views, and with the numbers that `Projection.of` finds for a `Camera`
of each, bit by bit: the same operations in the same order on doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.given_poses import KEPT_FLOATS, GivenPoses
from solari_vk.bound.projection import FIELDS, Projection, lens_point
from solari_vk.errors import SolariError, quoted
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.packing import packing
from solari_vk.gpu.shaders.spirv import Binding
from solari_vk.scene import checks
from solari_vk.scene.exposed import exposure_of
from solari_vk.scene.lens import UNLIMITED
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
DEFAULTS = Camera()
LARGEST_EV100 = 100.0
NARROWEST, WIDEST = 1e-4, math.pi - 1e-4  # vertical fields of view of a Camera, in radians


class Written(NamedTuple):
    """What is known of cameras beside their records."""

    lenses: list[Camera]
    """Those with a lens, which is a feature of the shaders."""
    apertures: dict[int, Camera]
    """Those with an aperture, by the view."""
    jitter: Floats
    """(N, 2): the cameras' own, in pixels of the picture."""
    principal_shift: Floats
    """(N, 2): from the principal point to the middle of the picture, in its pixels."""
    exposure: Floats
    """(N,)"""
    poses: Taken | None = None
    """Poses in a tensor of the device, which a shader writes to the records; None where the records have them."""


class ViewTable:
    """The records of a batch's views on the device, for one of its frames. columns: of the grid of their pictures.
    world_parts: of the world cache."""

    def __init__(self, device: Device, layout: Binding, count: int, columns: int = 1, world_parts: int = 1) -> None:
        assert layout.element is not None
        self.records = np.zeros(count, layout.element)
        self._begin = layout.element_offset
        self._device = device
        self.buffer = device.buffer(self._begin + self.records.nbytes, "views")
        self._shared = columns, world_parts
        self._shared_seen: tuple[int, ...] = ()
        self.has_own_lights = False
        """Whether each world has lights of its own."""
        self._current, self._previous = (self._bytes_of(layout.element, name) for name in ("current", "previous"))
        self._shown = False
        self.given_poses = GivenPoses(device, "Batch.render", "view")
        self._poses: Taken | None = None
        self._earlier: Buffer | None = None  # cameras of tensors, of the latest frame that had one
        self._had_tensor = False

    def _bytes_of(self, layout: np.dtype[Any], name: str) -> NDArray[np.uint8]:
        """The memory of a field (N, bytes), in which numpy copies it ten times as fast as by its fields."""
        assert layout.fields is not None
        dtype, begin = layout.fields[name][:2]
        rows = self.records.view(np.uint8).reshape(len(self.records), layout.itemsize)
        return rows[:, begin : begin + dtype.itemsize]

    def show(self, current: NDArray[Any], cut: NDArray[np.bool_], poses: Taken | None = None) -> None:
        """Make these the cameras of the next frame, and those so far the previous ones, but for views that are cut.
        poses: of a tensor, which are 0 in `current`."""
        now = current.view(np.uint8).reshape(self._current.shape)
        if self._shown:
            self._previous[:] = self._current
            self._previous[cut] = now[cut]
        else:
            self._previous[:] = now
        self._current[:] = now
        self._shown, self._had_tensor, self._poses = True, self._poses is not None, poses
        if poses is not None:  # tells cameras.comp, when this is the previous camera, that it was a tensor's
            self.records["current"]["world_from_view"][:, 0, 0] = 1

    def upload(self, ball: Buffer | None = None) -> None:
        """Have the device see the records, in the next submission. ball: gets the one around cameras of tensors."""
        shared = (*self._shared, int(self.has_own_lights))
        if shared != self._shared_seen:
            self._shared_seen = shared
            self.buffer.upload(np.array(shared, np.uint32))
        self.buffer.upload(self.records, self._begin)
        if self._poses is None and not self._had_tensor:
            return
        count, layout = len(self.records), self.records.dtype.fields
        assert layout is not None
        if self._earlier is None:
            self._earlier = self._device.buffer(4 * KEPT_FLOATS * count, "cameras of tensors")
        (camera, begin), previous = layout["current"][:2], layout["previous"][1]
        place = self._begin + begin + camera.fields["world_from_view"][1]
        self.given_poses.write(
            self._poses, "the pose", count, (self.buffer.address, place // 4, self.records.itemsize // 4),
            (self._earlier.address, 0, KEPT_FLOATS), "cameras", (previous - begin) // 4,
            None if self._poses is None else ball,
        )  # fmt: skip

    def destroy(self) -> None:
        """Free everything."""
        self.given_poses.destroy()
        for buffer in (self.buffer, self._earlier):
            if buffer is not None:
                buffer.destroy()


def array(value: Any, what: str, *shapes: tuple[int, ...], where: str = "Batch.render") -> Floats:
    """Finite numbers of one of these shapes, from numpy, lists, or what has __array__ or __dlpack__ in host memory."""
    try:
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
            value = np.from_dlpack(value)
        given: Floats = checks.real(value, np.float64)
        if given.shape not in shapes:
            raise ValueError(f"must have the shape {' or '.join(map(str, shapes))}, not {given.shape}")
        checks.refuse_not_finite(given)
    except (TypeError, ValueError, OverflowError, RuntimeError, BufferError) as error:
        raise SolariError(f"{where}: {what} {error}") from None
    return given


def check_all(right: NDArray[np.bool_], rule: str, what: str, where: str = "Batch.render", of: str = "view") -> None:
    """Raise SolariError that names the first view, or what it is `of`, for which a rule isn't `right` (N, ...)."""
    if not right.all():
        wrong = np.flatnonzero(~right.reshape(len(right), -1).all(axis=1))
        more = f", as of {len(wrong) - 1} more {of}s" if len(wrong) > 1 else ""
        raise SolariError(f"{where}: {what} of {of} {wrong[0]} must {rule}{more}")


def check_transforms(given: Floats, what: str = "the pose", where: str = "Batch.render", of: str = "view") -> None:
    """Raise SolariError unless all matrices (N, 4, 4) are affine and invertible: the rules of `Camera.transform`."""
    names = what, where, of
    check_all(np.isfinite(given), "be finite", *names)
    check_all(given[:, 3] == (0, 0, 0, 1), "be affine, with the last row 0 0 0 1", *names)
    check_all(np.abs(given) <= checks.LARGEST_TRANSFORM, f"lie within {checks.LARGEST_TRANSFORM:g}", *names)
    (a, b, c), (d, e, f), (g, h, i) = np.ascontiguousarray(np.moveaxis(given[:, :3, :3], 0, -1))
    volume = a * (e * i - h * f) + d * (h * c - b * i) + g * (b * f - e * c)
    lengths = np.sqrt((a * a + d * d + g * g) * (b * b + e * e + h * h) * (c * c + f * f + i * i))
    rule = "be invertible: no axis may have a scale of 0, and the axes may not lie in one plane"
    check_all(np.abs(volume) > 1e-9 * lengths, rule, *names)


def _each(function: Callable[[float], float], numbers: Floats) -> Floats:
    """A function of `math` for all views: numpy's own rounds some results differently."""
    if (numbers == numbers[0]).all():
        return np.full(len(numbers), function(float(numbers[0])))
    return np.fromiter(map(function, numbers.tolist()), np.float64, len(numbers))


def write_lenses(records: NDArray[Any], half: Floats, principal_shift: Floats, near: Floats) -> None:
    """Write pinhole cameras (N,) but for their poses. half (N, 2): half the picture in focal lengths. principal_shift
    (N, 2): from the principal point to the middle of the picture, in pixels."""
    records["tan_half_fov"], records["near"] = half, near
    records["jitter"] = records["principal_shift"] = principal_shift
    records["focus_distance"] = DEFAULTS.focus_distance
    records["lens"]["limit"] = records["lens"]["reach"] = UNLIMITED


def write_poses(records: NDArray[Any], poses: Floats) -> None:
    """Write checked poses (N, 4, 4); glsl/scene/given/cameras.comp does the same."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = np.ascontiguousarray(np.moveaxis(poses[:, :3], 0, -1))
    p, q, r = (np.sqrt(u * u + v * v + w * w) for u, v, w in ((a, d, g), (b, e, h), (c, f, i)))
    a, d, g, b, e, h, c, f, i = a / p, d / p, g / p, b / q, e / q, h / q, c / r, f / r, i / r
    volume = a * (e * i - h * f) + d * (h * c - b * i) + g * (b * f - e * c)
    j, k, m = (e * i - h * f) / volume, (h * c - b * i) / volume, (b * f - e * c) / volume
    n, o, p = (f * g - i * d) / volume, (i * a - c * g) / volume, (c * d - f * a) / volume
    q, r, s = (d * h - g * e) / volume, (g * b - a * h) / volume, (a * e - d * b) / volume
    shift = (-j * x - k * y - m * z, -n * x - o * y - p * z, -q * x - r * y - s * z)
    columns = (a, d, g, b, e, h, c, f, i, x, y, z), (j, n, q, k, o, r, m, p, s, *shift)
    for name, numbers in zip(("world_from_view", "view_from_world"), columns, strict=True):
        records[name] = np.stack(numbers, -1).reshape(-1, 4, 3)


def write_cameras(records: NDArray[Any], cameras: Sequence[Camera], size: tuple[int, int]) -> Written:
    """Write the records (N,) of cameras of any kind, one after the other."""
    packed, begin = packing(records.dtype, FIELDS)
    memory = records.view(np.uint8).data
    offsets = np.zeros((2, len(cameras), 2))
    written = Written([], {}, offsets[0], offsets[1], np.zeros(len(cameras)))
    for index, camera in enumerate(cameras):
        found = Projection.of(camera, size)
        jitter = map(sum, zip(found.jitter, found.principal_shift, strict=True))
        at = index * records.dtype.itemsize + begin
        shift = found.principal_shift
        packed.pack_into(memory, at, *found.numbers, *size, *size, *jitter, *shift, 0.0, 0.0, *found.lens)
        written.jitter[index], written.principal_shift[index] = found.jitter, shift
        written.exposure[index] = found.exposure
        if camera.has_lens:
            written.lenses.append(camera)
        if camera.aperture:
            written.apertures[index] = camera
    return written


def write_samples(
    records: NDArray[Any], written: Written, size: tuple[int, int], render_size: tuple[int, int], offsets: Floats,
    numbers: NDArray[np.int64],
) -> Floats:  # fmt: skip
    """Move the samples of records (N,) by offsets (N, 2) in pixels of what is rendered for pictures of this size, and
    to the points of apertures of these numbers (N,). Returns the offsets of the user's own (N, 2).
    `CameraUniforms.write_projection` does the same for one camera."""
    scale = np.divide(render_size, size)
    shift = written.principal_shift * scale
    records["size"] = render_size
    records["jitter"], records["principal_shift"] = written.jitter * scale + offsets + shift, shift
    for index, camera in written.apertures.items():
        records["lens_offset"][index] = lens_point(camera, int(numbers[index]))
    return written.jitter


def of_fov(fov: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """`half` and `principal_shift` of `write_poses` from vertical fields of view (N,) in radians."""
    check_all((fov >= NARROWEST) & (fov <= WIDEST), f"lie between {NARROWEST:g} and pi - {NARROWEST:g} radians",
              "the vertical field of view")  # fmt: skip
    half_height = _each(math.tan, fov / 2)
    half = np.stack([half_height * size[0] / size[1] / 1.0, half_height], -1)
    return half, np.zeros_like(half)


def of_matrices(K: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """`half` and `principal_shift` of `write_poses` from matrices (N, 3, 3), as `Camera.from_opencv` reads them."""
    fx, fy, cx, cy = K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]
    plain = (K[:, 0, 1] == 0) & (K[:, 1, 0] == 0) & (K[:, 2] == (0, 0, 1)).all(axis=1) & (fx > 0) & (fy > 0)
    check_all(plain, "be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], with fx and fy above 0 and no skew", "K")
    width, height = size
    fov = 2 * _each(math.atan, height / 2 / fy)
    half_height = of_fov(fov, size)[0][:, 1]
    half = np.stack([half_height * width / height / (fx / fy), half_height], -1)
    center = np.stack([(cx + 0.5) / width, (cy + 0.5) / height], -1)
    check_all((np.abs(center) <= 10).all(axis=1) & (fx / fy <= 1e3) & (fy / fx <= 1e3),
              "have a principal point within 10 pictures and fx / fy between 0.001 and 1,000", "K")  # fmt: skip
    return half, (0.5 - center) * size


def camera_list(cameras: Any, views: int) -> list[Camera] | None:
    """The cameras of a sequence of `Camera`, or None for an array of poses. Raises SolariError for a wrong count, and
    for a mixture."""
    if isinstance(cameras, Camera):
        cameras = [cameras]
    if not isinstance(cameras, (list, tuple)) or not any(isinstance(camera, Camera) for camera in cameras):
        return None
    wrong = [camera for camera in cameras if not isinstance(camera, Camera)]
    if wrong or len(cameras) != views:
        what = f"one is {quoted(wrong[0])}" if wrong else f"there are {len(cameras)}"
        raise SolariError(f"Batch.render: give {views} cameras, one for each view; {what}")
    return list(cameras)


def write(records: NDArray[Any], cameras: Any, size: tuple[int, int], options: Mapping[str, Any]) -> Written:
    """Write the records (N,) of Camera objects or of an array of poses; of a tensor's, all but the poses. size: of a
    view in pixels. options: fov, vertical_fov, K, near and ev100 of `Batch.render`; None for what isn't given."""
    count = len(records)
    given = {name: value for name, value in options.items() if value is not None}
    found = camera_list(cameras, count)
    records["size"] = records["picture_size"] = size
    if found is not None:
        if given:
            raise SolariError(f"Batch.render: Camera objects have their own {', '.join(given)}: leave it out")
        return write_cameras(records, found, size)
    near, ev100 = given.pop("near", DEFAULTS.near), given.pop("ev100", DEFAULTS.ev100)
    if len(given) > 1:
        raise SolariError(f"Batch.render: give one of {', '.join(given)}")
    if not isinstance(cameras, Taken):
        poses = array(cameras, "cameras", (count, 4, 4))
        check_transforms(poses)
        write_poses(records, poses)
    if "K" in given:
        matrices = array(given["K"], "K", (count, 3, 3), (3, 3))
        half, shift = of_matrices(np.broadcast_to(matrices, (count, 3, 3)), size)
    else:
        name, value = next(iter(given.items()), ("vertical_fov", DEFAULTS.vertical_fov))
        fov = np.broadcast_to(array(value, name, (count,), ()), count)
        half, shift = of_fov(fov * (math.pi / 180) if name == "fov" else fov, size)
    nears = np.broadcast_to(array(near, "near", (count,), ()), count)
    check_all((nears >= 1e-9) & (nears <= checks.LARGEST_COORDINATE),
              f"lie between 1e-9 and {checks.LARGEST_COORDINATE:g} m", "near")  # fmt: skip
    exposures = np.broadcast_to(array(ev100, "ev100", (count,), ()), count)
    check_all(np.abs(exposures) <= LARGEST_EV100, f"lie between -{LARGEST_EV100:g} and {LARGEST_EV100:g}", "ev100")
    write_lenses(records, half, shift, nears)
    poses_on_device = cameras if isinstance(cameras, Taken) else None
    return Written([], {}, np.zeros((count, 2)), shift, _each(exposure_of, exposures), poses_on_device)
