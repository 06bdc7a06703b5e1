"""Calibrated cameras: matrices and distortion as in OpenCV, points in the picture, rays of pixels."""

from __future__ import annotations

import math
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.bounds import bounds_of
from solari_vk.scene.lens import TERMS, Lens, make_lens
from solari_vk.scene.matrices import is_rotation, transform_points
from solari_vk.scene.matrices import rotation as rotation_about

Floats = NDArray[np.float64]
FROM_OPENCV = np.diag((1.0, -1.0, -1.0))  # of axes: cameras here have y up and look along -z
LENS_FIELDS = ("projection", "pixel_aspect", "principal_point", "distortion", "image_circle", "eye_offset")
"""The fields of a camera that say which lens it has."""


ROUNDING = 1e-9  # of a focal length, in results of other programs: no pixel moves by as much


def lens_of(camera: Any, size: tuple[int, int]) -> Lens:
    """The lens of a camera in a picture of this size; of an orthographic camera in meters for focal lengths.

    Raises SolariError for a distortion that isn't invertible in the picture.
    """
    distortion = tuple(camera.distortion.tolist())
    if camera.projection == "equirectangular":
        # Longitude and latitude themselves, in radians, are the coordinates.
        half = (math.pi, math.pi / 2)
        distortion = (camera.eye_offset,)
    elif camera.projection == "cube":
        half = (6.0, 1.0)  # six faces of 90 degrees in a row, each of which reaches from -1 to 1
    else:
        half_height = _half_height(camera)
        half = (half_height * size[0] / size[1] / camera.pixel_aspect, half_height)
    x, y = camera.principal_point.tolist()
    try:
        return make_lens(camera.projection, half, (x, y), distortion, camera.image_circle, tuple(size))
    except SolariError as error:
        raise SolariError(f"{camera.describe()}: {error}") from None


def _half_height(camera: Any) -> float:
    """Half the height of a picture without distortion, in focal lengths: the radius at which the projection shows half
    the vertical field of view. Of an orthographic camera in meters."""
    if camera.orthographic_height:
        return float(camera.orthographic_height / 2)
    half_fov: float = camera.vertical_fov / 2
    if camera.projection == "fisheye":
        return half_fov
    if camera.projection == "stereographic":
        return 2 * math.tan(half_fov / 2)
    return math.tan(half_fov)


def _matrix(value: ArrayLike, what: str, *shape: int | None) -> Floats:
    try:
        return np.asarray(checks.array(*shape, dtype=np.float64)(value), np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SolariError(f"Camera.from_opencv: {what} {error}") from None


def _size(size: Any) -> tuple[int, int]:
    pair = np.asarray(size)
    if pair.shape != (2,) or pair.dtype.kind not in "iu" or not (pair > 0).all():
        raise SolariError(f"Camera: size is (width, height) in pixels, not {quoted(size)}")
    return int(pair[0]), int(pair[1])


def _opencv_rotation(R: ArrayLike) -> Floats:
    """A rotation (3, 3) from one, or from OpenCV's rotation vector (3,), whose length is the angle about it
    (cv2.Rodrigues)."""
    if np.size(R) == 3:
        vector = _matrix(np.ravel(R), "R", 3)
        return rotation_about(vector, float(np.linalg.norm(vector))) if vector.any() else np.eye(3)
    rotation = _matrix(R, "R", 3, 3)
    if not is_rotation(rotation):
        raise SolariError(
            "Camera.from_opencv: R is a rotation from the world to the camera. The rows of this one "
            f"aren't perpendicular and of length 1, or it mirrors: {rotation.tolist()}"
        )
    return rotation


@np.errstate(divide="ignore", invalid="ignore")
def plain_matrices(K: Floats) -> tuple[Floats, Any]:
    """Matrices K (..., 3, 3) with a last element of 1, and whether each is one of a camera without skew. They may come
    from other programs: a decomposition leaves rounding errors, and K up to a factor."""
    skews = np.abs(K[..., (0, 1), (1, 0)]).max(axis=-1)
    # Beside the last element these are 1 in pixels over the focal length, whatever that is.
    tilts = np.abs(K[..., 2, :2]).max(axis=-1)
    is_plain = (skews <= ROUNDING * K[..., 0, 0]) & (tilts <= ROUNDING * K[..., 2, 2])
    focal = np.minimum(np.minimum(K[..., 0, 0], K[..., 1, 1]), K[..., 2, 2])
    return K / K[..., 2:, 2:], is_plain & (focal > 0)


def _without_zeros(distortion: ArrayLike | None, projection: str) -> Floats:
    """The numbers of a distortion without zeros at its end, with which other programs fill up, and the tilt's rounding
    errors; in OpenCV None is no distortion."""
    numbers = _matrix(np.ravel(() if distortion is None else distortion), "distortion", None)
    allowed = TERMS.get(projection, TERMS["fisheye"])
    if len(numbers) in allowed and len(numbers) <= 8:
        return numbers
    fitting = (count for count in allowed if (np.abs(numbers[count:]) <= ROUNDING).all())
    return numbers[: next(fitting, len(numbers))]


class Calibrated:
    """The part of `Camera` that speaks of pixels, in OpenCV's convention: pixel centers are whole numbers, as the
    indices of arrays are. The center of the first pixel is (0, 0), and the picture's top left corner (-0.5, -0.5)."""

    transform: Floats

    @classmethod
    def from_opencv(
        cls,
        K: ArrayLike,
        R: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        t: ArrayLike = (0, 0, 0),
        size: tuple[int, int] | None = None,
        distortion: ArrayLike = (),
        *,
        projection: str = "perspective",
        **fields: Any,
    ) -> Self:
        """A camera as OpenCV's calibration gives it.

        K (3, 3): focal lengths and principal point in pixels of a picture of `size` (width, height), without skew; size
        must be given; pictures of other sizes show the same. R (3, 3), or OpenCV's rotation vector rvec (3,), t (3,) in
        meters: a point is at R @ world + t in the camera's frame, which has x right, y down and z forward. distortion:
        k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tx, ty]]]], of which the tilt t must be 0, or with
        projection="fisheye" k1 to k4 as of cv2.fisheye; also "stereographic". fields: further arguments of the
        constructor. Raises SolariError for numbers that aren't finite, skew, an R that isn't a rotation, and a
        distortion that isn't invertible in the picture.
        """
        if size is None:
            raise SolariError("Camera.from_opencv: give size=(width, height), of the picture that K belongs to")
        scaled, is_plain = plain_matrices(_matrix(K, "K", 3, 3))
        (fx, _, cx), (_, fy, cy), _ = scaled.tolist()
        shift = _matrix(np.ravel(t), "t", 3)
        rotation = _opencv_rotation(R)
        width, height = _size(size)
        if not is_plain:
            raise SolariError(
                "Camera.from_opencv: K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], with fx and fy above 0 "
                f"and no skew, not {np.asarray(K).tolist()}"
            )
        transform = np.eye(4)
        # OpenCV's R and t lead from the world to the camera, a transform here the other way.
        transform[:3, :3] = rotation.T @ FROM_OPENCV
        transform[:3, 3] = -rotation.T @ shift
        # The inverse of `_half_height`. The picture's middle need not be the principal point.
        half = height / 2 / fy
        wide = {"fisheye": 2 * half, "equidistant": 2 * half, "stereographic": 4 * math.atan(half / 2)}
        fov = wide.get(projection, 2 * math.atan(half))
        camera = cls(
            transform=transform,
            projection=projection,
            vertical_fov=fov,
            pixel_aspect=fx / fy,
            # OpenCV counts from the center of the first pixel, a principal point from the picture's corner.
            principal_point=((cx + 0.5) / width, (cy + 0.5) / height),
            distortion=_without_zeros(distortion, projection),
            **fields,
        )  # type: ignore[call-arg]
        lens_of(camera, (width, height))
        return camera

    def intrinsics(self: Any, size: tuple[int, int]) -> Floats:
        """OpenCV's matrix K (3, 3) for pictures of this size; `distortion` is a field. Raises SolariError for
        orthographic cameras, panoramas and cubes, which have none."""
        if self.orthographic_height or self.projection in ("equirectangular", "cube"):
            raise SolariError(f"{self.describe()}: orthographic cameras, panoramas and cubes have no intrinsic matrix")
        width, height = _size(size)
        fy = height / 2 / lens_of(self, (width, height)).half[1]
        # The jitter moves the picture, so that the principal point moves the other way.
        (x, y), (dx, dy) = self.principal_point.tolist(), self.jitter.tolist()
        return np.array([[fy * self.pixel_aspect, 0, x * width - dx - 0.5], [0, fy, y * height - dy - 0.5], [0, 0, 1]])

    def extrinsics(self) -> tuple[Floats, Floats]:
        """R (3, 3) and t (3,): a point of the world is at R @ point + t in OpenCV's camera frame."""
        axes = self.transform[:3, :3] / np.linalg.norm(self.transform[:3, :3], axis=0)
        # inv and not the transpose: axes may have a shear.
        rotation = FROM_OPENCV @ np.linalg.inv(axes)
        return rotation, -rotation @ self.transform[:3, 3]

    def _pixels(self: Any, size: tuple[int, int]) -> tuple[Lens, Floats, Floats]:
        """The lens, the principal point in pixels, and the pixels of a focal length, (2,) each."""
        width, height = _size(size)
        lens = lens_of(self, (width, height))
        pixels = np.array((width, height), np.float64)
        return lens, self.principal_point * pixels - self.jitter - 0.5, pixels / 2 / np.array(lens.half)

    def project(self: Any, points: ArrayLike, size: tuple[int, int]) -> Floats:
        """Where points of the world (..., 3) are in a picture of this size, (..., 2) in pixels.

        NaN for points that the camera doesn't see: behind it, beyond its image circle, or where a distortion folds.
        Points beyond the picture's edges have positions too.
        """
        rotation, shift = self.extrinsics()
        world = np.asarray(points, np.float64)
        if world.shape[-1:] != (3,):
            raise SolariError(f"Camera.project: points have the shape (..., 3), not {world.shape}")
        # In OpenCV's camera frame.
        seen = world @ rotation.T + shift
        lens, center, scale = self._pixels(size)
        if self.orthographic_height:
            return np.asarray(np.where(seen[..., 2:] > 0, seen[..., :2], np.nan) * scale + center)
        return np.asarray(lens.positions(seen) * scale + center)

    def rays(self: Any, pixels: ArrayLike, size: tuple[int, int]) -> tuple[Floats, Floats]:
        """What pixels (..., 2) of a picture of this size look along: origins and unit directions in the world, (..., 3)
        each. NaN where a lens sees nothing."""
        start, along = self._lines(pixels, size)
        return start, along / np.linalg.norm(along, axis=-1, keepdims=True)

    def unproject(self: Any, pixels: ArrayLike, depth: ArrayLike, size: tuple[int, int]) -> Floats:
        """The points of the world (..., 3) that pixels (..., 2) show at depths (...), as `frame["depth"]` has them."""
        start, along = self._lines(pixels, size)
        return np.asarray(start + np.asarray(depth, np.float64)[..., None] * along)

    def _lines(self: Any, pixels: ArrayLike, size: tuple[int, int]) -> tuple[Floats, Floats]:
        """The point at a depth is start + depth * along, (..., 3) each."""
        positions = np.asarray(pixels, np.float64)
        if positions.shape[-1:] != (2,):
            raise SolariError(f"Camera: pixels have the shape (..., 2), not {positions.shape}")
        lens, center, scale = self._pixels(size)
        at = (positions - center) / scale
        if self.orthographic_height:
            start = np.concatenate([at, np.zeros_like(at[..., :1])], -1)
            along = np.array((0.0, 0.0, 1.0))
        else:
            start = lens.starts(at)
            along = lens.directions(at)
        axes = np.eye(4)
        axes[:3, :3] = self.transform[:3, :3] / np.linalg.norm(self.transform[:3, :3], axis=0) @ FROM_OPENCV
        axes[:3, 3] = self.transform[:3, 3]
        return transform_points(axes, start), np.broadcast_to(along, start.shape) @ axes[:3, :3].T

    def focus_on(self: Any, target: Any, f_number: float, *, sensor_height: float = 0.024) -> Any:
        """Focus on a point (3,) in meters, at a distance in meters along the view axis, or on the middle of an
        instance's box, and return the camera.

        f_number: of a lens with this camera's field of view, on a sensor of this height in meters (full frame). Its
        focal length over the f-number is the aperture: f/1.4 blurs more than f/8. Raises SolariError for a target that
        isn't before the camera, an f-number that isn't positive, and orthographic cameras, panoramas and cubes, which
        have no focal length.
        """
        distance = self._distance_to(target)
        has_none = self.orthographic_height or self.projection in ("equirectangular", "cube")
        if not distance > 0 or not f_number > 0 or has_none:
            raise SolariError(
                "Camera.focus_on: a camera with a focal length, a target before it and a positive "
                f"f-number are needed, not {distance:g} m and f/{f_number}"
            )
        # The picture's half height is in focal lengths, the sensor's in meters.
        focal_length = sensor_height / 2 / lens_of(self, (1, 1)).half[1]
        self.update(focus_distance=distance, aperture=focal_length / f_number)
        return self

    def _distance_to(self: Any, target: Any) -> float:
        """The distance at which `focus_on` focuses: along the view axis, of wide lenses along the ray."""
        if hasattr(target, "posed_mesh"):
            box = bounds_of([target])
            target = box.center if box is not None else target
        try:
            point = np.asarray(target, np.float64)
        except (TypeError, ValueError):
            raise SolariError(f"Camera.focus_on: target is a point (3,) or a distance, not {quoted(target)}") from None
        if point.shape not in ((), (3,)):
            raise SolariError(f"Camera.focus_on: target is a point (3,) or a distance, not of the shape {point.shape}")
        if point.shape == ():
            return float(point)  # a distance
        to_camera = self.transform[:3, 3] - point
        if self.projection != "perspective":
            return float(np.linalg.norm(to_camera))
        back = self.transform[:3, 2] / np.linalg.norm(self.transform[:3, 2])
        return float(to_camera @ back)


def pixel_rays(camera: Any, pixels: Floats, size: tuple[int, int]) -> tuple[Floats, Floats, Floats]:
    """Origins and unit directions (N, 3) of what pixels (N, 2) look along, and where the rays begin (N), at `near`."""
    origins, directions = camera.rays(pixels, size)
    forward = -camera.transform[:3, 2] / np.linalg.norm(camera.transform[:3, 2])
    # `near` counts along the view axis for perspective cameras, as in OpenGL, and along the ray for all others.
    along = directions @ forward if camera.projection == "perspective" else np.ones(len(pixels))
    return origins, directions, camera.near / np.maximum(along, 1e-9)
