"""A scanned mesh: `sv.open("scan.ply")`.

The file of an ammonite has triangles with colors of vertices, millimeters, and z up. Normals are smooth, but for edges
sharper than 40 degrees.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import solari_vk as sv

TURNS = 4.2
AROUND = 96  # points around the tube, and along the spiral
ALONG = 1200


def ammonite() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) in millimeters, triangles (M, 3) and sRGB codes (N, 3): a tube with ribs along a spiral."""
    turn, across = np.meshgrid(
        np.linspace(0, 2 * np.pi * TURNS, ALONG), np.arange(AROUND) * 2 * np.pi / AROUND, indexing="ij"
    )
    grown = 1.9 ** ((turn - turn.max()) / (2 * np.pi))  # of each turn to the next
    rib = np.maximum(0, np.sin(turn * 17)) ** 2
    tube = 20 * grown * (1 + 0.10 * rib * (1 - 0.4 * np.cos(across)))
    away = 44 * grown + tube * np.cos(across) * 0.85
    points = np.stack([away * np.cos(turn), away * np.sin(turn), tube * np.sin(across) * 1.05], axis=-1)
    points += 0.15 * np.random.default_rng(3).normal(size=points.shape)  # a scanner's noise
    band = 0.5 + 0.5 * np.sin(turn * 3.1 + 1.5 * np.sin(across * 2))
    shade = (0.72 + 0.28 * rib)[..., None]
    colors = shade * (np.array((168, 120, 78)) + band[..., None] * (55, 70, 70))
    first = np.arange((ALONG - 1) * AROUND).reshape(ALONG - 1, AROUND)
    beside = np.roll(first, -1, axis=1)
    corners = [first, first + AROUND, beside, beside, first + AROUND, beside + AROUND]
    return points.reshape(-1, 3), np.stack(corners, axis=-1).reshape(-1, 3), colors.reshape(-1, 3)


def scene(assets: Path) -> sv.Scene:
    """The ammonite through a PLY file, standing on its rim."""
    points, triangles, colors = ammonite()
    vertices = np.zeros(len(points), np.dtype([("place", "<f4", 3), ("color", "u1", 3)]))
    vertices["place"] = points[:, [0, 2, 1]]
    vertices["color"] = np.clip(colors, 0, 255)
    faces = np.zeros(len(triangles), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    faces["count"] = 3
    faces["corners"] = triangles[:, ::-1]
    numbers = "".join(f"property float {axis}\n" for axis in "xyz")
    numbers += "".join(f"property uchar {channel}\n" for channel in ("red", "green", "blue"))
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{numbers}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ammonite.ply"
        path.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())
        made = sv.load(path, up="z", unit=0.001)
    made.camera = sv.Camera.framing(made.bounds, (-0.45, -0.25, -1.0), aspect=16 / 9)
    return sv.studio_lights(made, camera=made.camera)
