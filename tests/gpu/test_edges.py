"""Hits within triangles by doubles and, for devices without them, by pairs of floats, against exact fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from solari_vk.lab.shader_runner import ShaderRunner

SHADER = """#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/trees/edges.glsl"
layout(local_size_x = 64) in;
struct Answer { vec3 found; uint is_met; uint is_front; };
layout(set = 0, scalar) readonly buffer SeenBlock { SeenTriangle at[]; } seen;
layout(set = 0, scalar) writeonly buffer AnswersBlock { Answer at[]; } answers;
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= seen.at.length()) { return; }
    vec3 found;
    bool is_front;
    bool is_met = meets_edges(seen.at[i], 0.75, found, is_front);
    answers.at[i] = Answer(found, uint(is_met), uint(is_front));
}
"""
COUNT = 3000


def triangles():
    """(COUNT, 9): three points (x, y) and their depths. In two of three the ray meets an edge, up to rounding; some are
    tiny or huge."""
    rng = np.random.default_rng(1)
    p, q, r = rng.normal(size=(3, COUNT, 2)).astype(np.float32)
    on_edge = np.float32(rng.uniform(0.1, 3, (COUNT, 1)))
    q[::3] = -on_edge[::3] * p[::3]
    r[1::3] = -on_edge[1::3] * q[1::3]
    size = np.float32(10.0) ** np.float32(rng.integers(-20, 13, (COUNT, 1)))
    depths = rng.uniform(0.5, 2, (COUNT, 3)).astype(np.float32)
    return np.hstack((p * size, q * size, r * size, depths)).astype(np.float32)


@pytest.mark.parametrize("header", ["", "#define WITHOUT_DOUBLES"])
def test_hits_are_exact(device, tmp_path, header):
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/edges.comp").write_text(SHADER)
    seen = triangles()
    with ShaderRunner(device, tmp_path) as shaders:
        answers = shaders.run("edges", COUNT, {"seen": seen}, {"answers": COUNT}, header=header)["answers"]
    for (px, py, qx, qy, rx, ry, *depths), answer in zip(seen.tolist(), answers, strict=True):
        p, q, r = ((Fraction(x), Fraction(y)) for x, y in ((px, py), (qx, qy), (rx, ry)))
        products = [(b[0] * a[1], b[1] * a[0]) for a, b in ((q, r), (r, p), (p, q))]
        edges = [gain - loss for gain, loss in products]
        is_met = sum(edges) != 0 and not (min(edges) < 0 < max(edges))
        if answer["is_met"] != is_met:
            # Of pairs an edge may be 0 that is far below the rounding of its products, never of the other sign.
            assert header, edges
            assert answer["is_met"], edges
            assert any(abs(a - b) < max(abs(a), abs(b)) * Fraction(2) ** -46 for a, b in products)
        if is_met:
            weights = [edge / sum(edges) for edge in edges]
            t = Fraction(0.75) * sum(weight * Fraction(depth) for weight, depth in zip(weights, depths, strict=True))
            assert answer["is_front"] == (sum(edges) > 0)
            np.testing.assert_allclose(answer["found"][0], float(t), rtol=1.2e-7)
            if header or abs(sum(edges)) > 1e-30:  # else the area is too small for a float
                np.testing.assert_allclose(answer["found"][1:], [float(weight) for weight in weights[1:]], atol=1e-6)
    assert 0.15 < np.mean(answers["is_met"]) < 0.5
