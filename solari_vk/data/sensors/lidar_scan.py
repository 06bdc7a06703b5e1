"""What a lidar found in one turn."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import followed, write_whole
from solari_vk.output.picture import write_npy

Floats = NDArray[np.float64]
POINT = np.dtype(
    [
        ("x", "<f8"),  # places in the world, which may be far from the origin
        ("y", "<f8"),
        ("z", "<f8"),
        ("intensity", "<f4"),
        ("distance", "<f4"),
        ("time", "<f4"),
        ("channel", "<u2"),
        ("column", "<u2"),
        ("number", "u1"),
        ("instance", "<i4"),
    ]
)
# PLY's names of types (Turk, "The PLY Polygon File Format", 1994), by numpy's.
PLY_TYPES = {"<f8": "double", "<f4": "float", "<u2": "ushort", "|u1": "uchar", "<i4": "int"}


@dataclass(frozen=True)
class LidarScan:
    """The returns of one turn, in the order of distance; arrays (channels, columns, returns)."""

    distance: Floats
    """In meters; NaN where nothing came back."""
    intensity: Floats
    """The reflectivity that a Lambertian surface there, facing the sensor, would have: the received power times the
    squared distance, with the receiver's noise. Retroreflection may exceed 1."""
    instance: NDArray[np.int32]
    """A key of the tracer's `instances`; -1 where nothing came back."""
    position: Floats
    """(..., 3) in meters in the world, by the pose of the column."""
    time: Floats
    """(columns,) in seconds since the scan began."""
    poses: Floats
    """World from sensor of each column, (columns, 4, 4)."""
    directions: Floats
    """Of the beams in the sensor's frame, (channels, columns, 3)."""

    @property
    def raw_position(self) -> Floats:
        """(channels, columns, returns, 3) in the sensor's frame, as if it had stood still: what a driver gives."""
        return self.distance[..., None] * self.directions[:, :, None]

    @property
    def points(self) -> NDArray[Any]:
        """The returns as records (N,): x, y, z in the world, intensity, distance, time, channel, column, number of the
        return, instance."""
        found = np.isfinite(self.distance)
        channel, column, number = np.nonzero(found)
        records = np.zeros(len(channel), POINT)
        for name, values in zip("xyz", self.position[found].T, strict=True):
            records[name] = values
        for name in ("intensity", "distance", "instance"):
            records[name] = getattr(self, name)[found]
        # All channels of a column fire at once.
        records["time"] = self.time[column]
        records["channel"] = channel
        records["column"] = column
        records["number"] = number
        return records

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the points as a .ply file, binary, or as a .npy file of records. Raises SolariError for another suffix,
        and for a file that can't be written."""
        target = Path(path)
        points = self.points
        if target.suffix.lower() == ".npy":
            write_npy(followed(target), points)
        elif target.suffix.lower() == ".ply":
            write_whole(followed(target), _ply(points))
        else:
            raise SolariError(f"{target}: point clouds are written as .ply or .npy, not '{target.suffix}'")


def _ply(points: NDArray[Any]) -> bytes:
    fields: Any = points.dtype.fields
    # The records are packed in the order of the properties, so their bytes are the file's.
    properties = (f"property {PLY_TYPES[fields[name][0].str]} {name}" for name in points.dtype.names or ())
    header = ("ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties, "end_header\n")
    return "\n".join(header).encode() + points.tobytes()
