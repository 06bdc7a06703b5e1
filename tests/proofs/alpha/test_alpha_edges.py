"""Rays aimed at edges and corners that triangles of panes, cards and glass share pass or meet each surface once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.scene.builtin import place
from solari_vk.scene.matrices import rotation

# At a distance of 1: within triangles of the squares, on their diagonals, and where eight triangles meet.
AIMS = [
    (0.2, 0.1),
    (-0.06, 0.16),
    (0.125, 0.125),
    (-0.0625, -0.0625),
    (1 / 6, 1 / 6),
    (0.1875, -0.1875),
    (0, 0),
    (0.125, 0),
]
NOISE = 0.11  # of means of 512 rays: five standard deviations
SHADER = f"""#version 460
#include "scene/walk.glsl"
#include "scene/trace.glsl"
layout(local_size_x = 1) in;
const vec2 AIMS[] = vec2[]({", ".join(f"vec2({x}, {y})" for x, y in AIMS)});
const uint RAYS = 512u;
struct Answer {{
    vec3 transmittance;  // of shadow rays
    float hits_per_ray;  // of rays that look for a surface and go on from it
    vec3 tint;           // of what these rays pass
    float camera_hits;   // of each of the camera's rays
}};
layout(set = 1, binding = 0, scalar) buffer AnswerBlock {{ Answer at[]; }} answer;
void main() {{
    uint rng = seed_rng(INVOCATION_INDEX, 0u, 1u), aim = INVOCATION_INDEX.x;
    if (aim >= AIMS.length()) {{ return; }}
    vec3 direction = vec3(AIMS[aim], -1.0), tint = vec3(0.0);
    uint hits = 0u, seen = 0u;
    for (uint ray = 0u; ray < RAYS; ray++) {{
        Hit hit = trace_closest_hit(vec3(0.0), 0.0, direction, 9.0, TRACE_BOTH_FACES, random_alpha_seed(rng));
        tint += trace_transmittance_and_probability(vec3(0.0), direction, 9.0, hit).weight;
        hits += hit.instance != NO_INDEX ? 1u : 0u;
        hit = trace_closest_hit(vec3(0.0), 0.0, direction, 9.0, TRACE_FRONT_FACES, random_alpha_seed(rng));
        seen += hit.instance != NO_INDEX ? 1u : 0u;
    }}
    vec3 transmittance = trace_transmittance(vec3(0.0), direction, 9.0);
    answer.at[aim] = Answer(transmittance, float(hits) / float(RAYS), tint / float(RAYS), float(seen) / float(RAYS));
}}
"""


def square_of(cells):
    """A square from -1 to 1 with two or, around its corners, eight triangles, which share positions but no vertex."""
    steps, corners = np.linspace(-1, 1, cells + 1), []
    for i in range(cells):
        for j in range(cells):
            (a, b), (c, d) = steps[i : i + 2], steps[j : j + 2]
            square = np.array([(a, c, 0), (b, c, 0), (b, d, 0), (a, d, 0)])
            corners.append(np.roll(square, -((i + j) % 2), axis=0)[[0, 1, 2, 0, 2, 3]])
    return sv.Mesh(positions=np.concatenate(corners))


def stack(material, distances, axis=(0, 0, 1), turn=0.0, at=(0, 0)):
    """Squares before each other, of both meshes in turn, turned about an axis; the camera looks at them along -z."""
    meshes, turned = [square_of(1), square_of(2)], np.eye(4)
    turned[:3, :3] = rotation(axis, turn)
    return sv.Scene(
        *(sv.Instance(meshes[i % 2], material, place(at=(*at, -z)) @ turned) for i, z in enumerate(distances, start=1))
    )


def glazing(material):
    """Two squares as one mesh, so close that structures for rays may hold triangles of both together."""
    near = square_of(1).positions
    both = sv.Mesh(positions=np.concatenate([near, near - np.float32((0, 0, 0.01))]))
    return sv.Scene(sv.Instance(both, material, place(at=(0, 0, -2))))


@pytest.fixture(scope="module", params=["query", "pipeline"])
def answers(request, any_device, tmp_path_factory):
    """What the shader answers for a scene, by either way to trace rays."""
    folder = tmp_path_factory.mktemp("glsl")
    (folder / "passes").mkdir()
    (folder / "passes" / "edges.comp").write_text(SHADER)
    stage = sv.Stage("edges", buffers={"answer": len(AIMS)}, passes=[sv.Pass("edges", threads=(len(AIMS), 1))])
    with sv.Device(validation=True, rays=request.param) as device:

        def ask(scene):
            with sv.SceneFrame(device, scene, [stage], glsl_root=folder) as frame:
                frame.submit()
                return frame["answer"].copy()

        yield ask


def test_panes_count_once(answers):
    """Closed forms for squares with alpha 0.5, whose color light doesn't take."""
    half = sv.Material(base_color=(1, 0.2, 0), alpha=0.5, alpha_mode="blend", double_sided=True)
    for count, scene in (
        (4, stack(half, (2, 2.5, 3, 3.5))),
        (2, stack(half, (2, 2.5), turn=math.pi / 4)),
        (2, glazing(half)),
        (2, stack(half, (2, 2.5), axis=(1, -1, 0), turn=0.7)),
    ):
        found = answers(scene)
        np.testing.assert_allclose(found["transmittance"], 0.5**count, rtol=1e-5)
        for name in ("hits_per_ray", "camera_hits"):
            np.testing.assert_allclose(found[name], 1 - 0.5**count, atol=NOISE)
        np.testing.assert_allclose(found["tint"], 1, rtol=1e-5)


def test_glass_walls_count_once(answers):
    """As elsewhere on the glass: the squares are moved to the side, so that no ray meets an edge."""
    clear = sv.Material(base_color=(0.4, 0.7, 0.5), transmission=1.0, perceptual_roughness=0.0, double_sided=True)
    edges, inside = (answers(stack(clear, (2, 2.5, 3), at=at)) for at in ((0, 0), (0.03, 0.01)))
    np.testing.assert_allclose(edges["transmittance"], inside["transmittance"], rtol=1e-5)
    assert (inside["transmittance"] > 0.04).all()
    np.testing.assert_array_equal(edges["camera_hits"], 1)
    for name in ("hits_per_ray", "tint"):
        np.testing.assert_allclose(edges[name], inside[name], atol=NOISE * 2**0.5)


@pytest.mark.parametrize("alpha", [0.3, 0.7])
def test_cards_are_there_or_not(answers, alpha):
    card = sv.Material(alpha=alpha, alpha_mode="mask", alpha_cutoff=0.5, double_sided=True)
    found = answers(stack(card, (2, 2.5)))
    assert (found["transmittance"] == (alpha < 0.5)).all()
    for name in ("hits_per_ray", "camera_hits"):
        assert (found[name] == (alpha > 0.5)).all()


BUGS = {
    "light passes each triangle": Bug("scene/alpha.glsl", "hit_edge", "return NO_EDGE;"),
    "all panes have the same edges": Bug(
        "scene/alpha.glsl", "hit_edge", "return min(correct(instance_index, mesh, triangle, barycentrics), 1u);"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BUGS)
def test_a_bug_is_noticed(answers, name):
    with seeded(BUGS[name]), pytest.raises(AssertionError):
        test_panes_count_once(answers)
