"""Cameras."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted, warn
from solari_vk.scene import checks
from solari_vk.scene.calibrated import LENS_FIELDS, Calibrated
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lens import PROJECTIONS, TERMS
from solari_vk.scene.observable import Checked, checked
from solari_vk.scene.placement import PARTS, Placed, resolved

LIKELY_RADIANS = 2.0  # degrees: who gives a smaller `fov` most often means radians
AIM = {"look_at", "target", "up"}
MIN_HEIGHT = 1e-9  # meters, as of `near`: the matrices of smaller pictures overflow


def _view(position: ArrayLike, target: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """The transform (4, 4) of a camera at a position that looks at a target."""
    try:
        eye, aim, above = (np.asarray(vector, np.float64) for vector in (position, target, up))
        if not eye.shape == aim.shape == above.shape == (3,):
            raise ValueError
    except OverflowError:
        raise SolariError("Camera: position, target and up must be finite and not too far apart") from None
    except (TypeError, ValueError):
        vectors = ", ".join(map(quoted, (position, target, up)))
        raise SolariError(f"Camera: position, target and up must be three numbers each, not {vectors}") from None
    with np.errstate(over="ignore", invalid="ignore"):
        # Cameras look along -z.
        back = eye - aim
        right = np.cross(above, back)
        lengths = np.linalg.norm(back), np.linalg.norm(right)
    if not np.isfinite(lengths).all():
        raise SolariError("Camera: position, target and up must be finite and not too far apart")
    if 0 in lengths:
        raise SolariError(
            "Camera: position and target must differ, and up must not lie along the view: a camera that looks straight "
            "down needs another, such as up=(0, 0, -1)"
        )
    transform = np.eye(4)
    transform[:3, 2] = back / lengths[0]
    transform[:3, 0] = right / lengths[1]
    transform[:3, 1] = np.cross(transform[:3, 2], transform[:3, 0])
    transform[:3, 3] = eye
    return transform


def _aimed(fields: dict[str, Any], current: Camera | None) -> dict[str, Any]:
    """Fields with a transform in place of position, look_at and up. current: the camera that is changed, if one is."""
    targets = [fields.pop(name) for name in ("look_at", "target") if name in fields]
    if len(targets) != 1:
        raise SolariError(
            "Camera: up goes with one look_at: Camera(position=(0, 1, 3), look_at=(0, 1, 0), up=(0, 1, 0))"
        )
    if fields.keys() & {"transform", "rotation"}:
        raise SolariError("Camera: look_at turns the camera: leave transform and rotation out, and give position")
    position = fields.pop("position", np.zeros(3) if current is None else current.position)
    return fields | {"transform": _view(position, targets[0], fields.pop("up", (0, 1, 0)))}


def _projection(value: Any) -> str:
    return checks.one_of(PROJECTIONS)("fisheye" if isinstance(value, str) and value == "equidistant" else value)


def _distortion(value: Any) -> NDArray[np.float64]:
    """Numbers, none if all are 0."""
    coefficients: NDArray[np.float64] = checks.array(None, dtype=np.float64, max_abs=1e6)(value)
    return coefficients if coefficients.any() else coefficients[:0]


def _transform(value: Any) -> NDArray[np.float64]:
    """An invertible matrix; a warning says that a left-handed one mirrors the picture."""
    found = checks.affine_transform(value)
    warn_of_mirroring(float(np.linalg.det(found[:3, :3])), "Camera: transform")
    return found


def warn_of_mirroring(determinant: float, what: str) -> None:
    if determinant < 0:
        warn(f"{what} is left-handed, so that pictures are mirrored: negate one of its axes, the columns x, y and z")


def _blades(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not (value == 0 or 3 <= value <= 64):
        raise ValueError(f"must be 0, for a disk, or a whole number from 3 to 64, not {quoted(value)}")
    return int(value)


class Unset(float):
    """A number that nobody chose. Copies of a camera keep it; any assignment replaces it."""


def _ev100(value: Any) -> float:
    """A finite number from -100 to 100, still `Unset` if it was."""
    number: Any = checks.number(-100, 100)(value)
    return value if isinstance(value, Unset) else float(number)


def exposure_of(ev100: float) -> float:
    """`Camera.exposure`."""
    # Saturation-based sensitivity: the largest luminance of a sensor at EV100 is 1.2 * 2^EV100 (Lagarde and de
    # Rousiers, "Moving Frostbite to Physically Based Rendering", 2014).
    return float(1.0 / (1.2 * 2.0**ev100))


class _Placing:
    """A class method that is `place` where it is called on an object."""

    def __init__(self, method: Any) -> None:
        self._method = method

    def __get__(self, camera: Camera | None, kind: type[Camera]) -> Callable[..., Camera]:
        bound: Callable[..., Camera] = self._method.__get__(camera, kind) if camera is None else camera.place
        return bound


@checked
class Camera(Checked, Placed, Calibrated):
    """A camera looking along its -z axis, +y up: perspective, or orthographic if it has an orthographic_height.

    transform is world from camera, (4, 4), or just a position (3,) in meters; `position` and `rotation` are its parts,
    which the constructor takes too. In place of a rotation it takes the point to look at, and perhaps what is up:
    Camera(position=(0, 1, 3), look_at=(0, 1, 0), fov=50). vertical_fov is in radians (`math.radians(45)`); fov is the
    same angle in degrees. orthographic_height is the height of the picture in meters; 0 means perspective. Surfaces
    closer than near, in meters, are not shown. ev100 is the exposure value at ISO 100: pictures show radiance / (1.2 *
    2^ev100). While nobody sets it, it is 0, and pictures that would be clearly too bright or too dark are shown and
    saved with another one, of which a warning tells. jitter (2,) shifts the picture, in pixels. aperture is the
    diameter of a thin lens in meters, which is focused at focus_distance, in meters along the view axis, of wide lenses
    along the ray; with 0 all is sharp. It is a disk, or with aperture_blades from 3 on a regular polygon with its
    corners on that circle, turned by aperture_rotation in radians. `focus_on` sets both as photographers do.
    auto_exposure: the first picture that a renderer makes with the camera chooses ev100, for which `render` waits
    (realtime: the first four frames); then it stays, as a number that is assigned does.

    projection: "perspective"; "fisheye", which is equidistant without distortion; "stereographic"; "equirectangular", a
    panorama of 360 x 180 degrees; or "cube", the six faces of `CameraRig.cube` in a row, for pictures six times as wide
    as high. eye_offset: of a panorama, how far in meters the eye is right of the camera, in whichever direction it
    looks: two of them are omnidirectional stereo. vertical_fov is the picture's without distortion. pixel_aspect is fx
    / fy. principal_point (2,) is where the view axis is, in shares of the picture from its top left corner. distortion:
    OpenCV's numbers, see `from_opencv`. image_circle: the angle in radians that a fisheye or stereographic lens sees;
    beyond it the picture is black.
    """

    _: KW_ONLY
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    vertical_fov: float = math.radians(45)
    orthographic_height: float = 0.0
    near: float = 0.01
    aperture: float = 0.0
    focus_distance: float = 1.0
    ev100: float = Unset(0.0)
    auto_exposure: bool = False
    jitter: FloatArray = field(default_factory=lambda: np.zeros(2, np.float32))
    projection: str = "perspective"
    pixel_aspect: float = 1.0
    principal_point: NDArray[np.float64] = field(default_factory=lambda: np.full(2, 0.5))
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    image_circle: float = 2 * math.pi
    eye_offset: float = 0.0
    aperture_blades: int = 0
    aperture_rotation: float = 0.0
    name: str = ""

    _converters = {
        "name": checks.text,
        "transform": _transform,
        "vertical_fov": checks.number(1e-4, 2 * math.pi, "radians (fov takes degrees)"),
        "orthographic_height": checks.number(0, checks.LARGEST_COORDINATE, "meters"),
        "near": checks.number(1e-9, checks.LARGEST_COORDINATE),
        "aperture": checks.number(0, checks.LARGEST_COORDINATE, "meters"),
        "focus_distance": checks.number(1e-9, checks.LARGEST_COORDINATE, "meters"),
        "ev100": _ev100,
        "auto_exposure": checks.flag,
        "jitter": checks.array(2),
        "projection": _projection,
        "pixel_aspect": checks.number(1e-3, 1e3),
        "principal_point": checks.array(2, dtype=np.float64, max_abs=10),
        "distortion": _distortion,
        "image_circle": checks.number(1e-4, 2 * math.pi, "radians"),
        "eye_offset": checks.number(-checks.LARGEST_COORDINATE, checks.LARGEST_COORDINATE, "meters"),
        "aperture_blades": _blades,
        "aperture_rotation": checks.number(-1e6, 1e6, "radians"),
    }

    _derived = ("position", "rotation", "fov", "look_at", "target", "up")
    _place = resolved

    @classmethod
    def _resolve(cls, fields: dict[str, Any], current: Any) -> dict[str, Any]:
        if "fov" in fields:
            if "vertical_fov" in fields:
                raise SolariError("Camera: fov is vertical_fov in degrees: give one of them")
            try:
                fields["vertical_fov"] = math.radians(checks.number(0.01, 360, "degrees")(fields.pop("fov")))
            except (TypeError, ValueError) as error:
                raise SolariError(f"Camera: fov {error}") from None
            fov = math.degrees(fields["vertical_fov"])
            if fov < LIKELY_RADIANS:
                warn(f"Camera: fov is in degrees, and {fov:g} is a telescope's: in radians it is vertical_fov={fov:g}")
        if not fields.keys().isdisjoint(AIM):
            fields = _aimed(fields, current)
        return cls._place(fields, current) if fields.keys() & {"transform", *PARTS} else fields

    @_Placing
    @classmethod
    def look_at(cls, position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 1, 0), **fields: Any) -> Camera:
        """A camera at a position that looks at a target, each (3,) in meters. fields: further arguments of the
        constructor, such as fov.

        To move a camera, use `place`. Raises SolariError if position and target are equal, if up is parallel to the
        view, and for numbers that aren't finite or overflow.
        """
        return cls(transform=_view(position, target, up), **fields)

    def place(self, position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 1, 0), **fields: Any) -> Camera:
        """Move the camera to a position, look at a target, and return the camera. Arguments and errors are those of
        `look_at`."""
        self.update(transform=_view(position, target, up), **fields)
        return self

    @classmethod
    def framing(
        cls,
        bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
        direction: ArrayLike = (-0.45, -0.3, -1.0),
        *,
        aspect: float = 1.0,
        vertical_fov: float = math.radians(35),
        margin: float = 1.1,
        orthographic: bool = False,
        **fields: Any,
    ) -> Camera:
        """A camera that looks along `direction` and sees the whole of a box, such as `scene.bounds`.

        bounds: the minimum and the maximum corner of the box, (3,) each, in meters. direction (3,) must not be
        vertical. aspect is width / height of the picture. With a margin of 1 the box touches the picture's edges.
        orthographic: instead of perspective. fields: further arguments of the constructor.
        """
        low, high = (np.asarray(corner, np.float64) for corner in bounds)
        center = (low + high) / 2
        camera = cls.look_at(center - np.asarray(direction, np.float64), center, vertical_fov=vertical_fov, **fields)
        corners = np.array(list(product(*zip(low, high, strict=True))))
        seen = (corners - center) @ camera.transform[:3, :3]
        # Half the picture's width and height at a distance of 1.
        slope = np.array((math.tan(vertical_fov / 2) * aspect, math.tan(vertical_fov / 2)))
        # The distance at which each corner is on the edge of the picture; z points towards the camera.
        distance = float((np.abs(seen[:, :2]) * margin / slope + seen[:, 2:]).max())
        extent = float(np.linalg.norm(high - low)) or 1.0
        transform = camera.transform.copy()
        transform[:3, 3] = center + transform[:3, 2] * max(distance, 1e-3 * extent)
        # The near plane in proportion to the box: a fixed one would cut small boxes.
        camera.update(transform=transform, near=max(1e-4 * extent, 1e-9))
        if orthographic:
            # The distance doesn't matter to a parallel projection, but what is before the near plane does.
            half_width, half_height = np.abs(seen[:, :2]).max(axis=0)
            camera.orthographic_height = 2 * margin * max(half_height, half_width / aspect)
        return camera

    @classmethod
    def from_pose(cls, pose: Any) -> Camera:
        """A camera from the result of `pose`, or from {"position": [x, y, z], "target": [x, y, z]}.

        Also takes "up", "vertical_fov_degrees" and the fields of POSED, or a whole "transform" for position and target.
        """
        known = {"position", "target", "up", "transform", "vertical_fov_degrees", *POSED, *LENS_FIELDS}
        if not isinstance(pose, dict) or not known.issuperset(pose):
            raise SolariError(f"a camera pose is a JSON object of {', '.join(sorted(known))}, not {quoted(pose)}")
        try:
            fields: dict[str, Any] = {name: float(pose[name]) for name in POSED if name in pose}
            if "aperture_blades" in fields:
                fields["aperture_blades"] = int(fields["aperture_blades"])
            fields |= {name: pose[name] for name in LENS_FIELDS if name in pose}
            if "vertical_fov_degrees" in pose:
                fields["vertical_fov"] = math.radians(pose["vertical_fov_degrees"])
            if "transform" in pose:
                return cls(transform=pose["transform"], **fields)
            return cls.look_at(pose["position"], pose["target"], pose.get("up", (0, 1, 0)), **fields)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"a camera pose needs 'position' and 'target', or 'transform': {error}") from None

    def pose(self) -> dict[str, Any]:
        """The argument of `from_pose`, as plain JSON values."""
        named = [name for name in POSED if name != "ev100" or self.has_exposure]
        return {
            "transform": self.transform.tolist(),
            "vertical_fov_degrees": math.degrees(self.vertical_fov),
            **{name: getattr(self, name) for name in named},
            **self.lens_fields(),
        }

    def lens_fields(self) -> dict[str, Any]:
        """Those of LENS_FIELDS that aren't as in a pinhole camera with square pixels, as plain JSON values."""
        values = {name: getattr(self, name) for name in LENS_FIELDS}
        plain = {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in values.items()}
        return {name: value for name, value in plain.items() if value != _PINHOLE[name]}

    @property
    def has_lens(self) -> bool:
        """Whether pictures aren't those of a pinhole or of a parallel projection: raster can't draw them."""
        return self.projection != "perspective" or len(self.distortion) > 0

    def _validate(self) -> None:
        kind = self.projection
        if kind == "perspective" and self.vertical_fov > math.pi - 1e-4:
            raise SolariError(
                f"{self.describe()}: vertical_fov must be at most pi - 0.0001 radians in a perspective "
                f"camera, not {self.vertical_fov:g}; a fisheye sees more"
            )
        if len(self.distortion) not in TERMS[kind]:
            raise SolariError(
                f"{self.describe()}: distortion of a {kind} camera has {_listed(TERMS[kind])} numbers, "
                f"not {len(self.distortion)}"
            )
        if self.has_lens and self.orthographic_height:
            raise SolariError(
                f"{self.describe()}: a {kind} camera with a lens model isn't orthographic: set orthographic_height to 0"
            )
        # A field without an effect is most likely a mistake.
        unused = set(self.lens_fields()) & UNUSED[kind]
        if unused:
            raise SolariError(f"{self.describe()}: a {kind} camera has no {' or '.join(sorted(unused))}")
        if 0 < self.orthographic_height < MIN_HEIGHT:
            raise SolariError(
                f"{self.describe()}: orthographic_height must be 0, which means perspective, or at least "
                f"{MIN_HEIGHT:g} m, not {self.orthographic_height:g}"
            )

    def update(self, **fields: Any) -> None:
        """Assign several fields at once; nothing is changed if one of them is refused."""
        # A number that someone sets ends the automatic choice.
        if "ev100" in fields and self._ready:
            fields.setdefault("auto_exposure", False)
        super().update(**fields)

    def __repr__(self) -> str:
        (x, y, z), (dx, dy, dz) = self.transform[:3, 3], 0 - self.transform[:3, 2]
        place = f"({x:.4g}, {y:.4g}, {z:.4g}) towards ({dx:.3g}, {dy:.3g}, {dz:.3g})"
        fov = f"vertical_fov={self.vertical_fov:.4g} ({math.degrees(self.vertical_fov):.3g} degrees)"
        lens = f"orthographic_height={self.orthographic_height:.4g}" if self.orthographic_height else fov
        lens = "".join(f"{name}={value}, " for name, value in self.lens_fields().items()) + lens
        rest = {"aperture": self.aperture, "auto_exposure": self.auto_exposure}
        more = "".join(f", {name}={value:.4g}" for name, value in rest.items() if value)
        return f"<{self.describe()} at {place}, {lens}, ev100={self.ev100:.4g}{more}>"

    @property
    def has_exposure(self) -> bool:
        """Whether ev100 was set: by the constructor, an assignment, a file, or a picture with auto_exposure."""
        return not isinstance(self.ev100, Unset)

    @property
    def exposure(self) -> float:
        """The factor by which pictures multiply radiance."""
        return exposure_of(self.ev100)

    @property
    def fov(self) -> float:
        """The vertical field of view in degrees: `vertical_fov`, which is in radians. May be assigned."""
        return math.degrees(self.vertical_fov)

    @fov.setter
    def fov(self, fov: float) -> None:
        self.update(fov=fov)


def _listed(numbers: tuple[int, ...]) -> str:
    return " or ".join(map(str, numbers))


_PINHOLE = {
    "projection": "perspective",
    "pixel_aspect": 1.0,
    "principal_point": [0.5, 0.5],
    "distortion": [],
    "image_circle": 2 * math.pi,
    "eye_offset": 0.0,
}
UNUSED = {
    "perspective": {"image_circle", "eye_offset"},
    "fisheye": {"eye_offset"},
    "stereographic": {"eye_offset"},
    "equirectangular": {"image_circle", "pixel_aspect", "principal_point"},
    "cube": {"image_circle", "pixel_aspect", "principal_point", "eye_offset"},
}
"""The fields that would have no effect."""

POSED = ("near", "ev100", "orthographic_height", "aperture", "focus_distance", "aperture_blades", "aperture_rotation")
"""The fields of a camera that a pose has under the same name."""
