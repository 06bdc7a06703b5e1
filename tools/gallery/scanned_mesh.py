"""A scanned mesh: `sv.open("scan.ply")`.

The file has triangles alone. Normals are smooth, but for edges sharper than 40 degrees.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A rough pebble as a scanner gives it, through a PLY file; millimeters, z up."""
    ball = sv.shapes.sphere(1.0, 160)
    direction = ball.positions.astype(np.float64)
    generator = np.random.default_rng(9)
    radius = np.ones(len(direction))
    for octave in range(1, 6):
        waves = generator.normal(size=(6, 3)) * 1.8**octave
        phases = generator.uniform(0, 2 * np.pi, 6)
        radius += 0.22 / 1.8**octave * np.sin(direction @ waves.T + phases).mean(axis=1)
    # A saw has cut the stone in half, which leaves a sharp edge.
    points = direction * radius[:, None] * (60, 45, 40)
    points[:, 2] = np.minimum(points[:, 2], 18 - 0.4 * points[:, 0] + 0.5 * points[:, 1])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pebble.ply"
        header = (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
            f"property float z\nelement face {len(ball.triangles)}\n"
            "property list uchar int vertex_indices\nend_header\n"
        )
        faces = np.zeros(len(ball.triangles), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
        faces["count"], faces["corners"] = 3, ball.triangles
        path.write_bytes(header.encode() + points.astype("<f4").tobytes() + faces.tobytes())
        made = sv.load(path, up="z", unit=0.001)
    camera = made.camera_for(4 / 3)
    sv.studio_lights(made, camera=camera)
    made.camera = camera
    return made
