"""The tree of lights: the probabilities of lights, and how close they are to the lights' shares of the light."""

from statistics import NormalDist

import numpy as np
from support.frames import bound_scene
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require, with_shaders
from support.statistics import chi_squared_p, standard_deviations

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, rgb

EQUAL = Rule("the probability of a light is the one with which a walk down the tree of lights ends there")
SUM = Rule("at each point, the probabilities of all lights have the sum 1")
OFTEN = Rule("lights of the tree are chosen as often as their probability says")
CLOSE = Rule("lights are chosen nearly in proportion to power times cosine over squared distance")
LAMPS = 150
POINTS = 24
DRAWS = 8192


def lamps_in_space(random):
    """Balls of light of many powers, in heaps, one of them much brighter than the rest; and a sun."""
    scene = sv.Scene(sv.DirectionalLight(direction=rgb((0, -1, 0)), illuminance=2.0))
    ball, middles = shapes.sphere(0.02, 6), random.uniform(-4, 4, (6, 3))
    for index in range(LAMPS):
        radiance = 30.0 if index == 7 else random.uniform(0.1, 2.0)
        scene.add(ball, lamp(radiance), tuple(middles[index % 6] + random.normal(scale=0.4, size=3)))
    return scene


def merged(scene):
    """The scene with all balls merged into one lamp."""
    balls = list(scene.instances)
    positions = np.concatenate([ball.mesh.positions + ball.transform[:3, 3] for ball in balls])
    count = len(balls[0].mesh.positions)
    triangles = np.concatenate([ball.mesh.triangles + count * index for index, ball in enumerate(balls)])
    return sv.Scene(sv.Instance(sv.Mesh(positions, triangles), lamp(1.0)), *scene.lights)


def measure_tree(shaders):
    """Draws and probabilities at random points, most of which face lights."""
    random = np.random.default_rng(3)
    scene = lamps_in_space(random)
    receivers = np.zeros(POINTS, shaders.element("test/light_tree", "receivers"))
    receivers["position"] = random.uniform(-5, 5, (POINTS, 3))
    normals = random.normal(size=(POINTS, 3)) - receivers["position"]
    receivers["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    yield from measure_leaves(shaders, scene, receivers, "lamps")
    yield from measure_leaves(shaders, merged(scene), receivers, "triangles of a lamp")
    yield from measure_leaves(shaders, sv.Scene(*scene.instances), receivers, "lamps without a sun")


def measure_leaves(shaders, scene, receivers, what):
    with bound_scene(shaders.device, scene) as binder:
        leaves = binder.lights.leaves
        count = leaves.count
        finite = count - len(scene.lights)
        records = leaves.table.records[:finite]
        shares = records["by_power"]["probability"].astype(np.float64)
        nodes = leaves.tree.records[records["node"]]
        powers, positions = nodes["power"].astype(np.float64), nodes["center"].astype(np.float64)
        found = shaders.run(
            "test/light_tree",
            POINTS * DRAWS,
            {**binder.resources, "receivers": receivers},
            {"drawn": POINTS * DRAWS, "probabilities": POINTS * count},
            constants={"SCENE_LIGHT_TREE": True},
        )
    drawn = found["drawn"].reshape(POINTS, DRAWS)
    probabilities = found["probabilities"].reshape(POINTS, count).astype(np.float64)
    expected = np.take_along_axis(probabilities, drawn["light"].astype(np.int64), axis=1)
    error = np.abs(drawn["probability"] / expected - 1).max()
    yield Measurement(EQUAL, float(np.nan_to_num(error, nan=np.inf)), 1e-5, "relative error")
    yield Measurement(SUM, float(np.abs(probabilities.sum(axis=1) - 1).max()), 1e-5, "absolute error")
    observed = np.stack([np.bincount(row, minlength=count) for row in drawn["light"]])
    z = standard_deviations(chi_squared_p(observed.ravel(), DRAWS * probabilities.ravel()))
    yield Measurement(OFTEN, z, NormalDist().inv_cdf(0.9999), "standard deviations", f"{POINTS} points, {what}")

    to_light = positions - receivers["position"][:, None].astype(np.float64)
    squared = (to_light**2).sum(axis=-1)
    cosine = np.einsum("rlc,rc->rl", to_light, receivers["normal"]).clip(min=0) / np.sqrt(squared)
    light = powers * cosine / squared
    lit = light.sum(axis=1) > 0
    of_lamps = probabilities[lit, :finite] / shares.sum()
    variance = (light[lit] ** 2 / of_lamps).sum(axis=1) / light[lit].sum(axis=1) ** 2 - 1
    note = f"{finite} {what}: variance of one sample without occlusion {variance.min():.2f} to {variance.max():.2f}"
    yield Measurement(CLOSE, float(variance.mean()), 0.27, "of the squared mean", note)


def test_the_path_tracer_chooses_by_the_tree(device):
    """Of two lamps of equal power the far one sends next to nothing. By power half of the samples would be of it."""
    scene = sv.Scene()
    scene.add(sv.shapes.quad((0, 0, 0), (2, 0, 0), (0, 0, -2)), sv.Material(base_color=(0.5, 0.5, 0.5)))
    for height in (1.0, 60.0):
        scene.add(sv.PointLight(position=(0, height, 0), intensity=100.0))
    camera = sv.Camera.look_at((0, 4, 0.01), (0, 0, 0), vertical_fov=0.4)
    with sv.PathTracer(device, scene, (8, 8), max_bounces=1, light_strategy="nee") as tracer:
        frame = tracer.render(camera, samples=64)
        light = frame["radiance"].mean(axis=2)
        relative = 64 * frame["variance"] / light**2
    assert (light > 0).all()
    assert relative.mean() < 0.1


def test_tree(shaders):
    require(measure_tree(shaders))


TREE = "scene/lights/tree.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        rule: (with_shaders(measure_tree), bug)
        for rule, bug in {
            EQUAL: Bug(
                TREE,
                "descend_light_tree",
                "ChosenLeaf chosen = correct(receiver, rng); "
                "chosen.probability = sqrt(chosen.probability); return chosen;",
            ),
            SUM: Bug(TREE, "node_probability", "return sqrt(correct(node, receiver));"),
            # the more likely of two lights is taken
            OFTEN: Bug(
                TREE,
                "choose_leaf",
                "ChosenLeaf one = correct(receiver, rng), other = correct(receiver, rng); "
                "return one.probability > other.probability ? one : other;",
            ),
            CLOSE: Bug(TREE, "MIN_COSINE", "1.0"),
        }.items()
    }
)
