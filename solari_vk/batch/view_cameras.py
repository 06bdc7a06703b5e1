"""The cameras of a batch's views: arrays of transforms, or Camera objects, as records of struct Camera of
glsl/scene/camera_records.glsl.

Arrays of transforms become records without a loop over views, and with the numbers that `Projection.of` finds for a
`Camera` of each, bit by bit: the same operations in the same order on doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.bound.projection import FIELDS, Projection
from solari_vk.gpu.frame.uniforms import packing
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene import checks
from solari_vk.scene.calibrated import plain_matrices
from solari_vk.scene.camera import exposure_of, warn_of_mirroring
from solari_vk.scene.lens import UNLIMITED
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
DEFAULTS = Camera()
LARGEST_EV100 = 100.0
# Of a camera: world_from_view, then view_from_world, by columns of 3.
MATRIX_NUMBERS = 24
_LAST_ROW = np.array([[0.0], [0.0], [0.0], [1.0]])
# Vertical fields of view of a Camera, in radians.
NARROWEST = 1e-4
WIDEST = math.pi - 1e-4


class ViewCameras(NamedTuple):
    """The cameras of the views of a frame."""

    records: NDArray[Any]
    """(N,): struct Camera, of pictures that are rendered in their size, which may lack the matrices. Frames of which it
    is the same array have the same cameras, but for `matrices`."""
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
    matrices: DeviceTensor | NDArray[np.float32]
    """Their world_from_view and view_from_world, (MATRIX_NUMBERS, N), or transforms in a tensor of the device, of which
    a shader makes these."""
    origins: Floats
    """From where each view's scene counts its coordinates on the device, (N, 3): `Scene.origin`."""


def array(value: Any, what: str, *shapes: tuple[int, ...], where: str) -> Floats:
    """Finite numbers of one of these shapes, from numpy, lists, or what has __array__ or __dlpack__ in host memory.
    They may be the value itself."""
    try:
        if hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
            value = np.from_dlpack(value)
        numbers: Floats = np.asarray(checks.real(value), np.float64)
        if numbers.shape not in shapes:
            raise ValueError(f"must have the shape {' or '.join(map(str, shapes))}, not {numbers.shape}")
        checks.refuse_not_finite(numbers)
    # Libraries of tensors raise RuntimeError and BufferError for tensors that they can't share.
    except (TypeError, ValueError, OverflowError, RuntimeError, BufferError) as error:
        raise SolariError(f"{where}: {what} {error}") from None
    return numbers


def check_all(right: NDArray[np.bool_], rule: str, what: str, where: str, of: str = "view") -> None:
    """Raise SolariError that names the first view, or what it is `of`, for which a rule isn't `right` (N, ...)."""
    if not right.all():
        wrong = np.flatnonzero(~right.reshape(len(right), -1).all(axis=1))
        more = f", as of {len(wrong) - 1} more {of}s" if len(wrong) > 1 else ""
        raise SolariError(f"{where}: {what} of {of} {wrong[0]} must {rule}{more}")


def check_transforms(
    matrices: Floats, what: str, where: str, of: str = "view"
) -> tuple[Floats, Floats, Floats, Floats]:
    """Raise SolariError unless all finite matrices (N, 4, 4) are affine and invertible: the rules of
    `Camera.transform`. Returns their axes with a length of 1, by rows (3, 3, N), the origins (3, N), the cross products
    of the axes, of which (3, i, N) is that of the two that follow axis i, and the volumes between the axes (N,)."""
    names = what, where, of
    # Each number of all matrices side by side, so that numpy works on long rows.
    rows = np.array(matrices.transpose(1, 2, 0), order="C")
    # The quick checks of all come first; what a message says of the wrong ones is computed where there are some.
    if not (rows[3] == _LAST_ROW).all():
        check_all((rows[3] == _LAST_ROW).T, "be affine, with the last row 0 0 0 1", *names)
    if rows.max() > checks.LARGEST_TRANSFORM or rows.min() < -checks.LARGEST_TRANSFORM:
        check_all(np.abs(matrices) <= checks.LARGEST_TRANSFORM, f"lie within {checks.LARGEST_TRANSFORM:g}", *names)
    # The first two rows and columns follow again, so that a cross product is a difference of products of blocks.
    axes = np.empty((5, 5, len(matrices)))
    squares = rows[:3, :3] * rows[:3, :3]
    lengths = np.sqrt(squares[0] + squares[1] + squares[2])
    lengths[lengths == 0] = np.inf  # which leaves no volume
    np.divide(rows[:3, :3], lengths, out=axes[:3, :3])
    axes[3:, :3] = axes[:2, :3]
    axes[:, 3:] = axes[:, :2]
    crossed = axes[1:4, 1:4] * axes[2:, 2:]
    crossed -= np.multiply(axes[2:, 1:4], axes[1:4, 2:], out=squares)
    parts = axes[:3, 0] * crossed[:, 0]
    volume = parts[0] + parts[1] + parts[2]
    rule = "be invertible: no axis may have a scale of 0, and the axes may not lie in one plane"
    check_all(np.abs(volume) > 1e-9, rule, *names)
    return axes[:3, :3], rows[:3, 3], crossed, volume


def _each(function: Callable[[float], float], numbers: Floats) -> Floats:
    """A function of `math` for all views: numpy's own rounds some results differently."""
    if (numbers == numbers[0]).all():
        return np.full(len(numbers), function(float(numbers[0])))
    return np.fromiter(map(function, numbers.tolist()), np.float64, len(numbers))


def camera_matrices(axes: Floats, origins: Floats, crossed: Floats, volume: Floats) -> NDArray[np.float32]:
    """world_from_view and view_from_world (MATRIX_NUMBERS, N) of transforms, of which `check_transforms` returned the
    rest; glsl/scene/tensors/cameras.comp does the same."""
    made = np.empty((8, 3, len(volume)), np.float32)
    made[:3] = axes.swapaxes(0, 1)
    made[3] = origins
    # A row of the inverse is the cross product of the other two axes, over the volume of all three.
    crossed /= volume
    made[4:7] = crossed
    # The inverse moves the camera's origin to 0.
    moved = np.multiply(crossed, origins[:, None], out=crossed)
    made[7] = -moved[0] - moved[1] - moved[2]
    return made.reshape(MATRIX_NUMBERS, -1)


def read_cameras(
    records: NDArray[Any], cameras: Sequence[Camera], size: tuple[int, int], origins: Floats
) -> ViewCameras:
    """Write the records (N,) of cameras of any kind, one after the other."""
    packed, begin = packing(records.dtype, FIELDS)
    memory = records.view(np.uint8).data
    count = len(cameras)
    matrices = np.zeros((MATRIX_NUMBERS, count), np.float32)
    jitters, shifts = np.zeros((2, count, 2))
    written = ViewCameras(records, [], {}, jitters, shifts, np.zeros(count), matrices, origins)
    for index, camera in enumerate(cameras):
        found = Projection.of(camera, size)
        jitter = map(sum, zip(found.jitter, found.principal_shift, strict=True))
        at = index * records.dtype.itemsize + begin
        shift = found.principal_shift
        numbers = found.numbers_from(origins[index].tolist())
        packed.pack_into(memory, at, *numbers, *size, *size, *jitter, *shift, 0.0, 0.0, *found.lens)
        written.jitter[index] = found.jitter
        written.principal_shift[index] = shift
        written.exposure[index] = found.exposure
        if camera.has_lens:
            written.lenses.append(camera)
        if camera.aperture:
            written.apertures[index] = camera
    matrices[:12] = records["world_from_view"].reshape(count, 12).T
    matrices[12:] = records["view_from_world"].reshape(count, 12).T
    return written


def of_fov(fov: Floats, size: tuple[int, int], where: str) -> tuple[Floats, Floats]:
    """Half the picture in focal lengths, and from the principal point to the middle of the picture in its pixels, both
    (N, 2), of vertical fields of view (N,) in radians."""
    check_all(
        (fov >= NARROWEST) & (fov <= WIDEST),
        f"lie between {NARROWEST:g} and pi - {NARROWEST:g} radians",
        "the vertical field of view",
        where,
    )
    # The same operations in the same order as of a `Camera`, whose pixels have an aspect ratio of 1.
    half_height = _each(math.tan, fov / 2)
    half = np.stack([half_height * size[0] / size[1] / 1.0, half_height], -1)
    return half, np.zeros_like(half)


def of_matrices(K: Floats, size: tuple[int, int], where: str) -> tuple[Floats, Floats]:
    """As `of_fov`, of matrices (N, 3, 3) as `Camera.from_opencv` reads them."""
    K, is_plain = plain_matrices(K)
    fx = K[:, 0, 0]
    fy = K[:, 1, 1]
    cx = K[:, 0, 2]
    cy = K[:, 1, 2]
    check_all(is_plain, "be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], with fx and fy above 0 and no skew", "K", where)
    width, height = size
    # By the field of view, as `Camera.from_opencv`, so that both find the same numbers.
    fov = 2 * _each(math.atan, height / 2 / fy)
    half_height = of_fov(fov, size, where)[0][:, 1]
    half = np.stack([half_height * width / height / (fx / fy), half_height], -1)
    # OpenCV counts pixels from the middle of the first one.
    center = np.stack([(cx + 0.5) / width, (cy + 0.5) / height], -1)
    check_all(
        (np.abs(center) <= 10).all(axis=1) & (fx / fy <= 1e3) & (fy / fx <= 1e3),
        "have a principal point within 10 pictures and fx / fy between 0.001 and 1,000",
        "K",
        where,
    )
    return half, (0.5 - center) * size


def camera_list(cameras: Any, views: int, where: str) -> list[Camera] | None:
    """The cameras of a sequence of `Camera`, or None for an array of transforms. Raises SolariError for a wrong count,
    and for a mixture."""
    if isinstance(cameras, Camera):
        cameras = [cameras]
    if not isinstance(cameras, (list, tuple)) or not any(isinstance(camera, Camera) for camera in cameras):
        return None
    wrong = [camera for camera in cameras if not isinstance(camera, Camera)]
    if wrong or len(cameras) != views:
        what = f"one is {quoted(wrong[0])}" if wrong else f"there are {len(cameras)}"
        raise SolariError(f"{where}: give {views} cameras, one for each view; {what}")
    return list(cameras)


def camera_of(cameras: Any, read: ViewCameras, view: int) -> Camera | None:
    """The camera of a view that the reader read, without the principal point of an array's; None if only the device
    knows it."""
    if isinstance(cameras, Camera):
        return cameras
    one = cameras[view] if isinstance(cameras, (list, tuple)) else None
    if isinstance(one, Camera):
        return one
    if isinstance(read.matrices, DeviceTensor):
        return None
    transform = np.eye(4)
    transform[:3] = read.matrices[:12, view].reshape(4, 3).T
    transform[:3, 3] += read.origins[view]
    record = read.records[view]
    fov = 2 * math.atan(float(record["tan_half_fov"][1]))
    return Camera(transform=transform, vertical_fov=fov, near=float(record["near"]))


class CameraReader:
    """Reads the cameras of a batch's frames. dtype: struct Camera. count: of views. size: of a view in pixels.
    origins: of `ViewCameras`."""

    def __init__(self, dtype: np.dtype[Any], count: int, size: tuple[int, int], origins: Floats) -> None:
        self._origins = origins
        self._dtype = dtype
        self._count = count
        self._size = size
        self._pinholes: ViewCameras | None = None  # the latest
        self._seen: dict[str, Any] = {}  # what they were made from
        self._plain: Mapping[str, Any] | None = None  # the same options, if all were single numbers

    def read(self, cameras: Any, options: Mapping[str, Any], where: str) -> ViewCameras:
        """Camera objects, an array of transforms, or a tensor of them. options: fov, vertical_fov, K, near and ev100 of
        `Batch.render`; None for those that aren't set. where: what asks, for messages."""
        options = {name: value for name, value in options.items() if value is not None}
        found = camera_list(cameras, self._count, where)
        if found is not None:
            if options:
                raise SolariError(f"{where}: Camera objects have their own {', '.join(options)}: leave it out")
            return read_cameras(np.zeros(self._count, self._dtype), found, self._size, self._origins)
        matrices: DeviceTensor | NDArray[np.float32]
        if isinstance(cameras, DeviceTensor):
            if (self._origins != self._origins[0]).any():
                raise SolariError(
                    f"{where}: the scenes of these worlds have different origins, which a tensor of cameras can't "
                    "follow: assign the same `Scene.origin` to all before the batch is made, or give an array in "
                    "the host's memory"
                )
            matrices = cameras
        else:
            transforms = array(cameras, "cameras", (self._count, 4, 4), where=where)
            checked = check_transforms(transforms, "the pose", where)
            warn_of_mirroring(float(checked[-1].min(initial=0)), f"{where}: a transform of cameras")
            axes, places, *rest = checked
            matrices = camera_matrices(axes, places - self._origins.T, *rest)
        return self._pinholes_of(options, where)._replace(matrices=matrices)

    def _pinholes_of(self, options: Mapping[str, Any], where: str) -> ViewCameras:
        """Pinhole cameras with any transforms: the latest, where they were made from the same numbers."""
        # Comparing single numbers is quicker than making arrays of them, which most frames need not do again.
        plain = all(type(value) in (int, float) for value in options.values())
        if plain and self._pinholes is not None and options == self._plain:
            return self._pinholes
        count = self._count
        shapes = {"K": ((count, 3, 3), (3, 3))}
        numbers = {
            name: array(value, name, *shapes.get(name, ((count,), ())), where=where) for name, value in options.items()
        }
        seen = {name: (value.shape, value.tobytes()) for name, value in numbers.items()}
        if self._pinholes is None or seen != self._seen:
            self._pinholes = self._make_pinholes(numbers, where)
            self._seen = seen
        self._plain = options if plain else None
        return self._pinholes

    def _make_pinholes(self, numbers: dict[str, Floats], where: str) -> ViewCameras:
        count = self._count
        near = np.broadcast_to(numbers.pop("near", np.float64(DEFAULTS.near)), count)
        ev100 = np.broadcast_to(numbers.pop("ev100", np.float64(DEFAULTS.ev100)), count)
        half, shift = self._intrinsics_of(numbers, where)
        check_all(
            (near >= 1e-9) & (near <= checks.LARGEST_COORDINATE),
            f"lie between 1e-9 and {checks.LARGEST_COORDINATE:g} m",
            "near",
            where,
        )
        check_all(
            np.abs(ev100) <= LARGEST_EV100, f"lie between -{LARGEST_EV100:g} and {LARGEST_EV100:g}", "ev100", where
        )
        records = np.zeros(count, self._dtype)
        records["size"] = self._size
        records["picture_size"] = self._size
        records["tan_half_fov"] = half
        records["near"] = near
        # A principal point beside the middle shifts the samples of pixels, as jitter does.
        records["jitter"] = shift
        records["principal_shift"] = shift
        records["focus_distance"] = DEFAULTS.focus_distance
        records["lens"]["limit"] = UNLIMITED
        records["lens"]["reach"] = UNLIMITED
        exposure = _each(exposure_of, ev100)
        no_matrices = np.empty((0, count), np.float32)
        return ViewCameras(records, [], {}, np.zeros((count, 2)), shift, exposure, no_matrices, self._origins)

    def _intrinsics_of(self, numbers: Mapping[str, Floats], where: str) -> tuple[Floats, Floats]:
        """As `of_fov`, of what gives the lens: at most one of fov, vertical_fov and K."""
        if len(numbers) > 1:
            raise SolariError(f"{where}: give one of {', '.join(numbers)}")
        if "K" in numbers:
            return of_matrices(np.broadcast_to(numbers["K"], (self._count, 3, 3)), self._size, where)
        if "fov" in numbers:
            return of_fov(np.broadcast_to(numbers["fov"], self._count) * (math.pi / 180), self._size, where)
        fov = numbers.get("vertical_fov", np.float64(DEFAULTS.vertical_fov))
        return of_fov(np.broadcast_to(fov, self._count), self._size, where)
