"""Encodings against numpy: bit for bit where arithmetic is exact, within a step of the format elsewhere."""

from __future__ import annotations

import numpy as np
from support.encodings import RGB9E5_MAX, encode_rgb9e5
from support.oracles.encodings import decode_rgb9e5, rgb9e5_step

EXPOSURE = 0.25


def inputs():
    rng = np.random.default_rng(3)
    count = 20_000
    colors = (rng.random((count, 3)) * 2.0 ** rng.uniform(-20, 17, (count, 1))).astype(np.float32)
    edges = [0, 1e-9, 2.0**-24, 2.0**-16, 1, 511.5 / 512, 511.75 / 512, 2, 3.9999, 65408, 65504, 1e9]
    colors[: len(edges)] = np.array(edges, np.float32)[:, None]
    colors[len(edges) : 2 * len(edges), 0] = edges
    directions = rng.normal(size=(count, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [-1, 1, 0], [0, -1, -1], [1e-7, -1e-7, -1]]])
    directions[: len(axes)] = axes
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    values = rng.uniform(-0.1, 1.1, count).astype(np.float32)
    values[:256] = np.arange(256) / 255
    return colors, directions, values


def test_packings(shaders):
    colors, directions, values = inputs()
    count = len(colors)
    given = {"colors": colors, "directions": directions, "values": values}
    out = shaders.run("test/packing", count, given, {"packed": 5 * count, "unpacked": 5 * count})
    packed, unpacked = out["packed"].reshape(-1, 5), out["unpacked"].reshape(-1, 5, 4).astype(np.float64)
    step = rgb9e5_step(packed)

    assert (packed[:, 0] == encode_rgb9e5(colors)).all()
    assert (unpacked[:, 0, :3] == decode_rgb9e5(packed[:, 0])).all()
    assert (np.abs(unpacked[:, 0, :3] - np.clip(colors, 0, RGB9E5_MAX)) <= 0.5 * step[:, :1]).all()

    encoded = np.log2(1 + colors.astype(np.float64) * EXPOSURE)
    decoded = np.log2(1 + unpacked[:, 1, :3] * EXPOSURE)
    assert (np.abs(decoded - encoded) <= 0.505 * step[:, 1:2] + 4e-6).all()

    for column, bound in ((2, 7e-5), (3, 1.1e-3)):
        angle = np.linalg.norm(unpacked[:, column, :3] - directions, axis=1)
        assert angle.max() < bound
        assert (unpacked[:6, column, :3] == directions[:6]).all(), "the axes are exact"

    codes = np.floor(np.clip(values.astype(np.float64), 0, 1) * 255 + 0.5).astype(np.uint32)
    between = np.abs((np.clip(values.astype(np.float64), 0, 1) * 255) % 1 - 0.5) < 1e-4
    assert ((packed[:, 4] == codes) | between).all()
    assert (packed[:256, 4] == np.arange(256)).all()
    assert np.abs(unpacked[:, 4, 0] - packed[:, 4] / 255).max() < 1e-7
