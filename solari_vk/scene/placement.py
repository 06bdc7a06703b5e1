"""Position, rotation and scale of what has a transform."""

from __future__ import annotations

from functools import partialmethod
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.matrices import is_rotation, nearest_rotation, quaternion_rotation, rotation, thickened, unit

PARTS = ("position", "rotation", "scale")


def rotation_matrix(value: Any) -> NDArray[np.float64]:
    """A rotation (3, 3) from one, from a quaternion (x, y, z, w), or from an angle in radians about +y."""
    values = checks.real(value, np.float64)
    checks.refuse_not_finite(values)
    if values.ndim == 0:
        return rotation((0, 1, 0), float(values))
    if values.shape == (4,) and values.any():
        return np.array(quaternion_rotation(*unit(values)))
    if values.shape != (3, 3) or not is_rotation(values):
        raise ValueError(
            "must be a quaternion (x, y, z, w), such as solari_vk.euler(0, 90, 0) gives for three angles "
            "in degrees, a rotation matrix (3, 3), which neither scales nor mirrors, or an angle in "
            "radians about +y"
        )
    return values


def _scale(value: Any) -> NDArray[np.float64]:
    factors = checks.real(value, np.float64)
    checks.refuse_not_finite(factors)
    least_above_0 = 2 if factors.shape == (3,) else 1
    is_negative = bool((factors < 0).any())
    if factors.shape not in ((), (3,)) or is_negative or np.count_nonzero(factors) < least_above_0:
        raise ValueError(
            "must be one factor or three, (3,), above 0, of which one of three may be 0 (a transform can mirror), not "
            f"{quoted(value)}"
        )
    # What is flattened has the thickness that transforms leave it.
    return thickened(np.diag((*np.broadcast_to(factors, (3,)), 1.0))).diagonal()[:3]


def parts(transform: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The position (3,), the rotation (3, 3) and the scale (3,) of a transform; what mirrors does so along x first."""
    axes = transform[:3, :3]
    scale = np.linalg.norm(axes, axis=0)
    # A rotation has a positive determinant. Which axis mirrors can't be told; x is taken.
    mirror = (np.sign(np.linalg.det(axes)), 1, 1)
    return transform[:3, 3].copy(), nearest_rotation(axes / scale * mirror), scale


def placed(
    transform: ArrayLike | None,
    who: str,
    position: Any = None,
    rotation: Any = None,
    scale: Any = None,
    *,
    may_flatten: bool = False,
) -> NDArray[np.float64]:
    """A transform (4, 4) with another position, rotation or scale; its shear stays. None: the identity.

    may_flatten: `checks.placing_transform` is its rule. Raises SolariError, with `who` at its start, for what is none
    of them.
    """
    converters = {
        "transform": checks.placing_transform if may_flatten else checks.affine_transform,
        "position": checks.array(3, dtype=np.float64),
        "rotation": rotation_matrix,
        "scale": _scale,
    }
    arguments = {"transform": transform, "position": position, "rotation": rotation, "scale": scale}
    values: dict[str, NDArray[np.float64]] = {"transform": np.eye(4)}
    for name, value in arguments.items():
        if value is not None:
            try:
                values[name] = converters[name](value)
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"{who}: {name} {error}") from None
    made = values["transform"].copy()
    _, turn, size = parts(made)
    if scale is not None:
        # Columns of the matrix are the axes: their lengths change, not their directions.
        made[:3, :3] *= values["scale"] / size
        _, turn, size = parts(made)
    if rotation is not None:
        # The present rotation is undone from the left, so that shear and mirroring stay.
        made[:3, :3] = values["rotation"] @ turn.T @ made[:3, :3]
    if position is not None:
        made[:3, 3] = values["position"]
    return made


@classmethod  # type: ignore[misc]
def resolved(cls: type[Any], fields: dict[str, Any], current: Any) -> dict[str, Any]:
    """`Checked._resolve` of what has a transform."""
    changed = {name: fields.pop(name) for name in PARTS if name in fields}
    # Parts that are set together with a transform replace those of the transform.
    before = fields.pop("transform", None if current is None else current.transform)
    who = cls.__name__ if current is None else current.describe()
    return fields | {"transform": placed(before, who, **changed, may_flatten=issubclass(cls, Scaled))}


class Part(np.ndarray[Any, np.dtype[np.float64]]):
    """A read-only copy of a part of a transform: errors for its elements, and for what other libraries' vectors have,
    say how to change the part. `+=` and the like make a new array, which Python then assigns."""

    __slots__ = ()

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Part:
        """A part that nobody can change by its elements, which would be lost."""
        part = values.view(cls)
        part.setflags(write=False)
        return part

    def __setitem__(self, key: Any, value: Any) -> None:
        if not self.flags.writeable:
            raise SolariError(
                "elements of position, rotation and scale are read-only, and nothing moved: assign the "
                "whole, as in instance.position = (x, y, z), or add to it by +="
            )
        super().__setitem__(key, value)

    def _in_place(self, function: Any, other: Any) -> Any:
        return function(self, other, out=self if self.flags.writeable else None)

    __iadd__ = partialmethod(_in_place, np.add)
    __isub__ = partialmethod(_in_place, np.subtract)
    __imul__ = partialmethod(_in_place, np.multiply)
    __itruediv__ = partialmethod(_in_place, np.divide)
    __imatmul__ = partialmethod(_in_place, np.matmul)
    __ipow__ = partialmethod(_in_place, np.power)

    def __getattr__(self, name: str) -> NoReturn:
        raise AttributeError(
            f"position, rotation and scale are arrays of numpy and have no '{name}': assign them, as "
            "in camera.position = (x, y, z)",
            name=None,  # without a suggestion of Python's own
        )

    def __setattr__(self, name: str, value: Any) -> None:
        if not hasattr(np.ndarray, name):
            getattr(self, name)
        super().__setattr__(name, value)


class Placed:
    """What has a transform, also as its parts. Subclasses have `transform` and `update`."""

    transform: NDArray[np.float64]

    def update(self, **fields: Any) -> None:
        """Assign several fields at once."""
        raise NotImplementedError

    @property
    def position(self) -> NDArray[np.float64]:
        """Where the origin of object space is in the world, (3,) in meters. May be assigned as a
        whole; its elements are read-only."""
        return Part.of(parts(self.transform)[0])

    @position.setter
    def position(self, position: ArrayLike) -> None:
        self.update(position=position)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """The rotation from object to world space, a matrix (3, 3) that neither scales nor mirrors: its columns are
        where the object's axes point. Assign such a matrix, a quaternion (x, y, z, w) as in glTF, of which `euler`
        makes one from three angles, or an angle in radians about +y; position, scale and shear stay."""
        return Part.of(parts(self.transform)[1])

    @rotation.setter
    def rotation(self, rotation: ArrayLike) -> None:
        self.update(rotation=rotation)


class Scaled(Placed):
    """What has a transform that may scale, also as its parts."""

    @property
    def scale(self) -> NDArray[np.float64]:
        """The lengths of the object's axes in the world, (3,). Assign three or one for all, above 0, of which one of
        three may be 0; what the transform mirrors stays mirrored."""
        return Part.of(parts(self.transform)[2])

    @scale.setter
    def scale(self, scale: ArrayLike) -> None:
        self.update(scale=scale)
