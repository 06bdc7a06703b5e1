"""Records of many cameras for shaders with MANY_VIEWS: struct View of glsl/scene/camera_block.glsl.

Arrays of poses become records without a loop over views, and with the numbers that `Projection.of` finds for a `Camera`
of each, bit by bit: the same operations in the same order on doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.projection import FIELDS, Projection
from solari_vk.errors import SolariError, quoted
from solari_vk.gpu.frame.packing import packing
from solari_vk.scene import checks
from solari_vk.scene.lens import UNLIMITED
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
DEFAULTS = Camera()
NARROWEST, WIDEST = 1e-4, math.pi - 1e-4  # vertical fields of view of a Camera, in radians


def array(value: Any, what: str, *shapes: tuple[int, ...]) -> Floats:
    """Finite numbers of one of these shapes, from numpy, lists, or what has __array__ or __dlpack__ in host memory."""
    try:
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
            value = np.from_dlpack(value)
        given: Floats = checks.real(value, np.float64)
        if given.shape not in shapes:
            raise ValueError(f"must have the shape {' or '.join(map(str, shapes))}, not {given.shape}")
        checks.refuse_not_finite(given)
    except (TypeError, ValueError, OverflowError, RuntimeError, BufferError) as error:
        raise SolariError(f"Batch.render: {what} {error}") from None
    return given


def check_all(right: NDArray[np.bool_], what: str, rule: str) -> None:
    """Raise SolariError that names the first view for which a rule doesn't hold."""
    if not right.all():
        wrong = np.flatnonzero(~right)
        more = f", as of {len(wrong) - 1} more views" if len(wrong) > 1 else ""
        raise SolariError(f"Batch.render: {what} of view {wrong[0]} must {rule}{more}")


def check_poses(poses: Floats) -> None:
    """Raise SolariError unless all matrices (N, 4, 4) are affine and invertible: the rules of `Camera.transform`."""
    check_all((poses[:, 3] == (0, 0, 0, 1)).all(axis=1), "the pose", "be affine, with the last row 0 0 0 1")
    check_all(np.abs(poses).max(axis=(1, 2)) <= checks.LARGEST_TRANSFORM, "the pose",
              f"lie within {checks.LARGEST_TRANSFORM:g}")  # fmt: skip
    axes = poses[:, :3, :3]
    lengths = np.linalg.norm(axes, axis=1).prod(axis=1)
    check_all(np.abs(np.linalg.det(axes)) > 1e-9 * lengths, "the pose",
              "be invertible: no axis may have a scale of 0, and the axes may not lie in one plane")  # fmt: skip


def _each(function: Callable[..., float], *arrays: Floats) -> Floats:
    """A function of `math` for all views: numpy's own rounds some results differently."""
    return np.fromiter(map(function, *(array.tolist() for array in arrays)), np.float64, len(arrays[0]))


def write_poses(records: NDArray[Any], poses: Floats, half: Floats, principal_shift: Floats, near: Floats) -> None:
    """Write pinhole cameras (N,) with checked poses (N, 4, 4). half (N, 2): half the picture in focal lengths.
    principal_shift (N, 2): from the principal point to the middle of the picture, in pixels."""
    axes = poses[:, :3, :3]
    axes = axes / np.stack([_each(math.hypot, *axes[:, :, column].T) for column in range(3)], -1)[:, None]
    ((a, b, c), (d, e, f), (g, h, i)), (x, y, z) = np.moveaxis(axes, 0, -1), poses[:, :3, 3].T
    volume = a * (e * i - h * f) + d * (h * c - b * i) + g * (b * f - e * c)
    j, k, m = (e * i - h * f) / volume, (h * c - b * i) / volume, (b * f - e * c) / volume
    n, o, p = (f * g - i * d) / volume, (i * a - c * g) / volume, (c * d - f * a) / volume
    q, r, s = (d * h - g * e) / volume, (g * b - a * h) / volume, (a * e - d * b) / volume
    shift = (-j * x - k * y - m * z, -n * x - o * y - p * z, -q * x - r * y - s * z)
    columns = (a, d, g, b, e, h, c, f, i, x, y, z), (j, n, q, k, o, r, m, p, s, *shift)
    for name, numbers in zip(("world_from_view", "view_from_world"), columns, strict=True):
        records[name] = np.stack(numbers, -1).reshape(-1, 4, 3)
    records["tan_half_fov"], records["near"] = half, near
    records["jitter"] = records["principal_shift"] = principal_shift
    records["focus_distance"] = DEFAULTS.focus_distance
    records["lens"]["limit"] = records["lens"]["reach"] = UNLIMITED


def write_cameras(records: NDArray[Any], cameras: Sequence[Camera], size: tuple[int, int]) -> None:
    """Write the records (N,) of cameras of any kind, one after the other."""
    packed, begin = packing(records.dtype, FIELDS)
    memory = records.view(np.uint8).data
    for index, camera in enumerate(cameras):
        found = Projection.of(camera, size)
        jitter = map(sum, zip(found.jitter, found.principal_shift, strict=True))
        at = index * records.dtype.itemsize + begin
        shift = found.principal_shift
        packed.pack_into(memory, at, *found.numbers, *size, *size, *jitter, *shift, 0.0, 0.0, *found.lens)


def of_fov(fov: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """`half` and `principal_shift` of `write_poses` from vertical fields of view (N,) in radians."""
    check_all((fov >= NARROWEST) & (fov <= WIDEST), "the vertical field of view",
              f"lie between {NARROWEST:g} and pi - {NARROWEST:g} radians")  # fmt: skip
    half_height = _each(math.tan, fov / 2)
    half = np.stack([half_height * size[0] / size[1] / 1.0, half_height], -1)
    return half, np.zeros_like(half)


def of_matrices(K: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """`half` and `principal_shift` of `write_poses` from matrices (N, 3, 3), as `Camera.from_opencv` reads them."""
    fx, fy, cx, cy = K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]
    plain = (K[:, 0, 1] == 0) & (K[:, 1, 0] == 0) & (K[:, 2] == (0, 0, 1)).all(axis=1) & (fx > 0) & (fy > 0)
    check_all(plain, "K", "be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], with fx and fy above 0 and no skew")
    width, height = size
    fov = 2 * _each(math.atan, height / 2 / fy)
    half_height = of_fov(fov, size)[0][:, 1]
    half = np.stack([half_height * width / height / (fx / fy), half_height], -1)
    center = np.stack([(cx + 0.5) / width, (cy + 0.5) / height], -1)
    check_all((np.abs(center) <= 10).all(axis=1) & (fx / fy <= 1e3) & (fy / fx <= 1e3), "K",
              "have a principal point within 10 pictures and fx / fy between 0.001 and 1,000")  # fmt: skip
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


def write(records: NDArray[Any], cameras: Any, size: tuple[int, int], options: Mapping[str, Any]) -> list[Camera]:
    """Write the records (N,) of Camera objects or of an array of poses; returns the cameras with a lens, which is a
    feature of the shaders. size: of a view in pixels. options: fov, vertical_fov, K and near of `Batch.render`; None
    for what isn't given."""
    count = len(records)
    given = {name: value for name, value in options.items() if value is not None}
    found = camera_list(cameras, count)
    records["size"] = records["picture_size"] = size
    if found is not None:
        if given:
            raise SolariError(f"Batch.render: Camera objects have their own {', '.join(given)}: leave it out")
        write_cameras(records, found, size)
        return [camera for camera in found if camera.has_lens]
    near = given.pop("near", DEFAULTS.near)
    if len(given) > 1:
        raise SolariError(f"Batch.render: give one of {', '.join(given)}")
    poses = array(cameras, "cameras", (count, 4, 4))
    check_poses(poses)
    if "K" in given:
        matrices = array(given["K"], "K", (count, 3, 3), (3, 3))
        half, shift = of_matrices(np.broadcast_to(matrices, (count, 3, 3)), size)
    else:
        name, value = next(iter(given.items()), ("vertical_fov", DEFAULTS.vertical_fov))
        fov = np.broadcast_to(array(value, name, (count,), ()), count)
        half, shift = of_fov(fov * (math.pi / 180) if name == "fov" else fov, size)
    nears = np.broadcast_to(array(near, "near", (count,), ()), count)
    check_all((nears >= 1e-9) & (nears <= checks.LARGEST_COORDINATE), "near",
              f"lie between 1e-9 and {checks.LARGEST_COORDINATE:g} m")  # fmt: skip
    write_poses(records, poses, half, shift, nears)
    return []
