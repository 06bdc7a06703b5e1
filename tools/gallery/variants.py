"""Variants of materials: one file in three colors.

`sv.load_gltf("mug.gltf", variant="Clay")`, of a file (`KHR_materials_variants`) whose mug is sold in three pairs
of colors.
"""

from __future__ import annotations

import base64
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import solari_vk as sv

AROUND = 96
COLORS = {
    "Lagoon": ((0.05, 0.3, 0.35), (0.9, 0.85, 0.75)),
    "Clay": ((0.5, 0.14, 0.06), (0.1, 0.08, 0.08)),
    "Lemon": ((0.85, 0.6, 0.08), (0.85, 0.83, 0.8)),
}
VARIANTS = "KHR_materials_variants"


def grid(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, normals and triangles of a surface through rows of points (M, N, 3), whose ends meet."""
    rows, columns = points.shape[:2]
    along = np.roll(points, -1, 1) - np.roll(points, 1, 1)
    across = np.gradient(points, axis=0)
    normals = np.cross(along, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-9)
    corners = np.arange(rows * columns).reshape(rows, columns)
    a, b = corners[:-1], np.roll(corners, -1, 1)[:-1]
    c, d = a + columns, b + columns
    triangles = np.concatenate([np.stack(part, 2).reshape(-1, 3) for part in ((a, b, c), (b, d, c))])
    return points.reshape(-1, 3), normals.reshape(-1, 3), triangles


def body() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cup with a wall of 4 cm, 1 m high."""
    radii, heights = (0.01, 0.36, 0.4, 0.42, 0.4, 0.38, 0.36, 0.01), (0, 0, 0.04, 0.96, 1, 0.96, 0.1, 0.06)
    at = np.linspace(0, len(radii) - 1, 120)
    profile = [np.interp(at, range(len(radii)), part) for part in (radii, heights)]
    smooth = np.stack([np.convolve(np.pad(part, 3, "edge"), np.ones(7) / 7, "valid") for part in profile], 1)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    radius, height = smooth[:, :1], np.repeat(smooth[:, 1:], AROUND, 1)
    return grid(np.stack([radius * np.cos(angle), height, -radius * np.sin(angle)], 2))


def handle() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A part of a torus that ends in the cup's wall."""
    turn, angle = np.linspace(-0.6 * np.pi, 0.6 * np.pi, 48)[:, None], 2 * np.pi * np.arange(24) / 24
    radius = 0.27 + 0.055 * np.cos(angle)
    points = [0.46 + radius * np.cos(turn), 0.52 + radius * np.sin(turn), 0 * turn + 0.07 * np.sin(angle)]
    return grid(np.stack(points, 2))


def write(path: Path) -> None:
    """The file, with a primitive for the body and one for the handle."""
    data = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def accessor(rows: np.ndarray, component: int, kind: str) -> int:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": rows.nbytes})
        data.extend(rows.tobytes())
        bounds = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()} if kind == "VEC3" else {}
        view = {"bufferView": len(views) - 1, "componentType": component, "count": len(rows), "type": kind}
        accessors.append(view | bounds)
        return len(accessors) - 1

    primitives = []
    for part, (positions, normals, triangles) in enumerate((body(), handle())):
        mappings = [{"material": 2 * number + part, "variants": [number]} for number in range(len(COLORS))]
        attributes = {
            "POSITION": accessor(positions.astype("<f4"), 5126, "VEC3"),
            "NORMAL": accessor(normals.astype("<f4"), 5126, "VEC3"),
        }
        indices = accessor(triangles.reshape(-1).astype("<u4"), 5125, "SCALAR")
        primitives.append(
            {
                "attributes": attributes,
                "indices": indices,
                "material": part,
                "extensions": {VARIANTS: {"mappings": mappings}},
            }
        )
    paints = [
        {
            "doubleSided": True,
            "pbrMetallicRoughness": {"baseColorFactor": [*color, 1], "metallicFactor": 0, "roughnessFactor": 0.3},
        }
        for pair in COLORS.values()
        for color in pair
    ]
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    path.write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "extensionsUsed": [VARIANTS],
                "extensions": {VARIANTS: {"variants": [{"name": name} for name in COLORS]}},
                "buffers": [{"byteLength": len(data), "uri": uri}],
                "bufferViews": views,
                "accessors": accessors,
                "materials": paints,
                "meshes": [{"primitives": primitives}],
                "nodes": [{"mesh": 0}],
                "scenes": [{"nodes": [0]}],
                "scene": 0,
            }
        )
    )


def scene(assets: Path | None) -> sv.Scene:
    """The mug in all its variants, side by side in the studio."""
    made = sv.Scene()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mug.gltf"
        write(path)
        for number, name in enumerate(COLORS):
            for instance in sv.load_gltf(path, variant=name):
                place = np.eye(4)
                place[0, 3] = 1.3 * (number - 1)
                made.add(instance.mesh, instance.material, place, name=f"{name} {instance.name}")
    made.camera = sv.Camera.framing(made.bounds, (0.12, -0.35, -1.0), aspect=16 / 9)
    return sv.studio_lights(made, camera=made.camera)
