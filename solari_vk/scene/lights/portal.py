"""Portals: openings through which the environment lights a room."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import LARGEST_COORDINATE, FloatArray
from solari_vk.scene.lights.light import Light
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.observable import checked

LEAST_SIDE, LARGEST_SIDE = 1e-5, 1e9
_LEAST_SINE = 1e-4  # of the angle between the sides
_FLATNESS = 1e-3  # of a mesh's corners, in lengths of its diagonal


@checked
class Portal(Light):
    """An opening of a room, such as a window, through which the scene's environment is sampled.

    center (3,): in meters. half_u, half_v (3,): half of its sides, as those of `shapes.quad`; a parallelogram is
    enough. Portals emit nothing and hide nothing, and no picture's mean depends on them: they say where light samples
    of the environment, an Environment or the map of a Sky, have a chance to arrive, and serve what lies on either side.
    Light also comes past them, by samples of the environment itself. The suns of skies aren't sampled through portals.

    A portal is chosen by the tree of lights, and a direction through it by the light that the environment sends from
    there: Bitterli, Novak and Jarosz, "Portal-Masked Environment Map Sampling" (2015). glsl/scene/lights/portal.glsl
    has the weights.
    """

    center: NDArray[np.float64]
    half_u: FloatArray
    half_v: FloatArray
    _: KW_ONLY
    name: str = ""

    _converters = {
        "center": checks.array(3, dtype=np.float64, max_abs=LARGEST_COORDINATE),
        "half_u": checks.array(3),
        "half_v": checks.array(3),
        "name": checks.text,
    }

    @classmethod
    def from_mesh(cls, mesh: Any, transform: ArrayLike | None = None, name: str = "") -> Portal:
        """The portal that a Mesh or an Instance covers, such as a window's pane: one flat parallelogram.

        transform (4, 4): from the mesh to the world, by default the instance's. Raises SolariError for a mesh of
        another shape.
        """
        shape = getattr(mesh, "mesh", mesh)
        points = getattr(shape, "positions", None)
        if points is None:
            raise SolariError(f"Portal.from_mesh: needs a Mesh or an Instance, not {type(mesh).__name__}")
        to_world = getattr(mesh, "transform", np.eye(4)) if transform is None else transform
        try:
            matrix = checks.affine_transform(to_world)
        except (TypeError, ValueError) as error:
            raise SolariError(f"Portal.from_mesh: transform {error}") from None
        corners = np.unique(points[shape.triangles.reshape(-1)], axis=0).astype(np.float64)
        center = corners.mean(axis=0)
        # Of four corners around the center of a parallelogram, one is opposite to the first, the others to each other.
        apart = corners - center
        # Opposite corners are each other's negatives around the center.
        opposite = np.abs(apart + apart[:1]).max(axis=1)
        fits = len(corners) == 4 and opposite.min() <= _FLATNESS * np.linalg.norm(apart[0])
        if not fits:
            raise SolariError(
                f"Portal.from_mesh: {shape.describe()} isn't one parallelogram of four corners, it has "
                f"{len(corners)}: give Portal its center and half sides"
            )
        beside = np.delete(apart, [0, opposite.argmin()], axis=0)[0]
        center, first, second = transform_points(matrix, np.stack([center, corners[0], center + beside]))
        # Neighboring corners are sum and difference of the half sides.
        a = first - center
        b = second - center
        return cls(center, (a - b) / 2, (a + b) / 2, name=name or getattr(mesh, "name", ""))

    @property
    def emits(self) -> bool:
        """Whether the light emits anything: never, since its light is that of the environment."""
        return False

    @property
    def area(self) -> float:
        """In square meters."""
        return float(np.linalg.norm(self._across))

    @property
    def cross_section(self) -> float:
        """In square meters, the mean over all directions: Cauchy (1841)."""
        return self.area / 2

    @property
    def _across(self) -> NDArray[np.float64]:
        """A vector (3,) at right angles to the portal, with its area as length."""
        found: NDArray[np.float64] = 4 * np.cross(self.half_u.astype(np.float64), self.half_v.astype(np.float64))
        return found

    @property
    def transform(self) -> NDArray[np.float64]:
        """The matrix (4, 4) that moves the square from (-1, -1, 0) to (1, 1, 0) to the portal."""
        matrix = np.eye(4)
        matrix[:3] = np.stack([self.half_u, self.half_v, self._across / self.area, self.center], axis=1)
        return matrix

    @staticmethod
    def placed(transform: NDArray[np.float64]) -> dict[str, Any]:
        """The fields of the portal that has this `transform`."""
        return dict(zip(("half_u", "half_v", "center"), transform[:3, (0, 1, 3)].T, strict=True))

    @staticmethod
    def fault(half_u: NDArray[Any], half_v: NDArray[Any]) -> str:
        """What is wrong with half sides; "" if they span a portal."""
        sides = np.stack([half_u, half_v]).astype(np.float64)
        lengths = np.linalg.norm(sides, axis=1)
        # Written so that NaN is a fault too.
        if not (lengths.min() >= LEAST_SIDE and lengths.max() <= LARGEST_SIDE):
            return f"half_u and half_v must be from {LEAST_SIDE:g} to {LARGEST_SIDE:g} m long"
        if np.linalg.norm(np.cross(*sides)) < _LEAST_SINE * lengths.prod():
            return "half_u and half_v must not have the same direction, since they are half of two sides"
        return ""

    def _validate(self) -> None:
        fault = self.fault(self.half_u, self.half_v)
        if fault:
            raise SolariError(f"{self.describe()}: {fault}")
