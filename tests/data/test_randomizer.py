"""Random scenes: a picture's number decides all, nothing is left behind, and wrong recipes name file and key."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from support.scenes import field_names

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.data.randomize.draws import check, draw
from solari_vk.data.randomize.recipe import _radiance, _texture
from solari_vk.scene.matrices import transform_points

RECIPE = """
cameras: {vertical_fov: [0.5, 0.9], roll: [-10, 10], ev: 0.5, principal_point: [[0.4, 0.4], [0.6, 0.6]]}
instances:
  "*block": {offset: [[-0.1, 0, -0.1], [0.1, 0, 0.1]], turn: [0, 360]}
  "tall block": {visible: {choose: [true, false]}}
materials:
  "*": {roughness: {log: [0.1, 1]}, base_color: [[0, 0, 0], [1, 1, 1]]}
  red: {base_color_texture: [a.png, b.png]}
lights:
  key: {brightness: [0.5, 2], offset: [[0, 0, 0], [0, 1, 0]], color: [1, 0.9, 0.8]}
environment: {image: [sky.exr], brightness: 2, turn: [0, 360]}
distractors: {count: [1, 4], shapes: [sphere, cone], size: [0.05, 0.1], within: [[0, 0, 0], [2, 2, 2]],
              material: {metallic: [0, 1]}}
"""


@pytest.fixture
def make(tmp_path):
    """make(text): a randomizer of a recipe, beside the pictures that RECIPE names."""
    for value, name in enumerate(("a", "b")):
        sv.save_image(tmp_path / f"{name}.png", np.full((2, 2, 3), value / 2))
    sv.save_image(tmp_path / "sky.exr", np.ones((2, 4, 3)))

    def load(text=RECIPE, name="random.yaml", seed=1):
        (tmp_path / name).write_text(text)
        return sv.Randomizer.load(tmp_path / name, seed)

    return load


def box():
    scene = sv.builtin("cornell_box")
    scene.add(sv.PointLight((1, 1.5, 1), name="key"))
    for instance in scene.instances:
        instance.material.update(name="red" if "left" in instance.name else instance.material.name or instance.name)
    scene.instances[0].material.name = "red"
    return scene


def state(scene):
    """All fields of all objects, as values that can be compared."""

    def plain(value):
        if isinstance(value, np.ndarray):
            return value.tobytes()
        if isinstance(value, sv.Texture):
            return value.image.pixels.tobytes()
        return {"name": value.name, "points": value.positions.tobytes()} if isinstance(value, sv.Mesh) else value

    objects = [*scene.instances, *scene.lights, *(instance.material for instance in scene.instances)]
    return [
        (type(item).__name__, [plain(getattr(item, name)) for name in field_names(type(item)) if name != "material"])
        for item in objects
    ]


def test_a_number_means_one_scene(make):
    """Alone, or after others; another number and another seed mean others; and the scene is as it was in the end."""
    randomizer, scene = make(), box()
    randomizer.prepare(scene)
    before, states = state(scene), []
    for number in (0, 1, 2):
        with randomizer.applied(scene, number):
            states.append(state(scene))
        assert state(scene) == before
    alone = box()
    randomizer.prepare(alone)
    with randomizer.applied(alone, 2):
        assert state(alone) == states[2]
    assert states[0] != states[1] != states[2]
    other = make(seed=2)
    with other.applied(alone, 2):
        assert state(alone) != states[2]


def middle(instance):
    low, high = instance.mesh.positions.min(axis=0), instance.mesh.positions.max(axis=0)
    return transform_points(instance.transform, (low + high) / 2.0)


def test_what_a_recipe_does(make):
    randomizer, scene = make(), box()
    base, place = middle(scene.instances["short block"]), scene.lights["key"].position.copy()
    randomizer.prepare(scene)
    colors = []
    shown = []
    textures = set()
    hidden = 0
    for number in range(40):
        with randomizer.applied(scene, number):
            moved = middle(scene.instances["short block"]) - base
            assert np.abs(moved[[0, 2]]).max() <= 0.1 + 1e-6
            assert moved[1] == pytest.approx(0)
            colors.append(scene.materials[1].base_color.copy())
            assert 0.1 <= scene.materials[1].roughness <= 1
            textures.add(int(scene.materials["red"].base_color_texture.image.pixels[0, 0, 0]))
            light = scene.lights["key"]
            assert 50 <= light.intensity <= 200
            assert 0 <= light.position[1] - place[1] <= 1
            np.testing.assert_allclose(light.color, (1, 0.9, 0.8), rtol=1e-6)
            assert scene.environment.intensity == 2
            added = [item for item in scene.instances if item.name.startswith("distractor") and item.visible]
            shown.append(len(added))
            for item in added:
                assert np.all((item.position >= 0) & (item.position <= 2))
                assert 0.05 <= item.scale[0] <= 0.1
            hidden += not scene.instances["tall block"].visible
    assert np.ptp(colors, axis=0).min() > 0.7
    assert set(shown) == {1, 2, 3, 4}
    assert len(textures) == 2
    assert 8 < hidden < 32
    cameras = [sv.Camera(position=(0, 1, 4)) for _ in range(20)]
    for number, camera in enumerate(cameras):
        randomizer.camera(camera, number)
        assert camera.ev100 == 0.5
        assert 0.5 <= camera.vertical_fov <= 0.9
        assert np.array_equal(camera.position, (0, 1, 4))
    assert len({camera.vertical_fov for camera in cameras}) == 20
    turns = [np.degrees(np.arctan2(camera.rotation[1, 0], camera.rotation[0, 0])) for camera in cameras]
    assert -10 <= min(turns) < -3 < 3 < max(turns) <= 10


def test_a_studios_floor_is_left_alone(make):
    """By patterns, and by distractors, which would lie tens of meters away."""
    scene = sv.studio_lights(box())
    recipe = make("distractors: {count: 4}\ninstances: {'*': {offset: [0, 1, 0]}}\nmaterials: {'*': {metallic: 1}}")
    recipe.prepare(scene)
    bounds, floor = scene.bounds, scene.backdrop
    with recipe.applied(scene, 0):
        assert floor.position[1] == floor.material.metallic == 0
        places = np.array([one.position for one in scene.instances if one.name.startswith("distractor")])
        assert (places >= bounds.min).all()
        assert (places <= bounds.max + np.array((0, 1, 0))).all()
    named = make("materials: {floor: {metallic: 1}}", "floor.yaml")
    with named.applied(scene, 0):
        assert floor.material.metallic == 1


def test_cameras_look_at_a_target(make):
    camera = sv.Camera()
    make("cameras: {target: [0, 1, 0], offset: [0, 0, 1], position: [[1, 2, 3], [4, 5, 6]]}").camera(camera, 0)
    towards = (np.array((0, 1, 0)) - camera.position) / np.linalg.norm(np.array((0, 1, 0)) - camera.position)
    np.testing.assert_allclose(-camera.transform[:3, 2], towards, atol=1e-12)
    assert 4 <= camera.position[2] <= 7, "it is moved before it is turned"


def test_parts_of_an_object_move_together(make):
    """By one draw, about the middle of all; other objects by their own; what isn't a place is assigned to each part."""
    scene = sv.Scene()
    for number in range(2):
        for part, x in enumerate((0.0, 2.0)):
            scene.add(
                sv.shapes.box(),
                name=f"chair {number}/{part}",
                position=(x + 9 * number, 0, 0),
                scale=1 + part,
                part_of=f"chair {number}",
            )
    before = [instance.transform for instance in scene.instances]
    recipe = "instances: {'chair ?': {scale: {log: [0.5, 2]}, offset: [[0, 1, 0], [0, 2, 0]], turn: [10, 350]}}"
    for text, turned in ((recipe, False), ("instances: {'chair*': {turn: [10, 350], visible: false}}", True)):
        randomizer = make(text)
        randomizer.prepare(scene)
        with randomizer.applied(scene, 3):
            moves = [
                instance.transform @ np.linalg.inv(was) for instance, was in zip(scene.instances, before, strict=True)
            ]
            visible = [instance.visible for instance in scene.instances]
        np.testing.assert_allclose(moves[0], moves[1], atol=1e-9)
        np.testing.assert_allclose(moves[2], moves[3], atol=1e-9)
        assert np.abs(moves[0] - moves[2])[:3, :3].max() > 0.1
        assert visible == [not turned] * 4
        if turned:
            np.testing.assert_allclose(transform_points(moves[0], np.array((1.25, 0, 0))), (1.25, 0, 0), atol=1e-9)


def test_a_further_key_leaves_the_others_values(make):
    first = make("materials: {red: {roughness: [0, 1]}}")
    more = make("materials: {red: {metallic: [0, 1], roughness: [0, 1]}, '*': {alpha: 1}}", "more.yaml")
    scene, found = box(), []
    for randomizer in (first, more):
        with randomizer.applied(scene, 5):
            found.append(scene.materials["red"].roughness)
    assert found[0] == found[1]
    with more.applied(scene, 5):
        assert scene.materials["red"].metallic != found[0]  # keys and objects have values of their own
    both = make("instances: {'*block': {turn: [0, 360]}}", "both.yaml")
    with both.applied(scene, 5):
        assert not np.allclose(scene.instances["short block"].rotation, scene.instances["tall block"].rotation)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera: {fov: 1}", "random.yaml: there is no key 'camera'; did you mean 'cameras'"),
        ("cameras: {fow: 1}", "random.yaml: cameras: there is no key 'fow'; did you mean 'fov'"),
        (
            "instances: {'*block': {positon: 1}}",
            r"instances: \*block: there is no key 'positon'; did you mean 'position'",
        ),
        ("materials: {red: {rougness: 1}}", "materials: red: there is no key 'rougness'; did you mean 'roughness'"),
        ("distractors: {cout: 1}", "distractors: there is no key 'cout'; did you mean 'count'"),
        ("distractors: {shapes: [bal]}", "distractors: shapes: there is no shape 'bal'"),
        ("materials: {red: {roughness: [1, 0]}}", None),
        (
            "materials: {red: {roughness: {logs: [1, 2]}}}",
            "roughness: there is no way to draw 'logs'; did you mean 'log'",
        ),
        ("materials: {red: {roughness: {log: [0, 1]}}}", "log takes two numbers above 0"),
        ("materials: {red: {base_color: [[0, 0, 0], [1, 1]]}}", "give a value, two numbers or two vectors"),
        ("materials: [red]", 'must have patterns of names, such as "Chair'),
        ("cameras: 3", "cameras: must have keys and values, not 3"),
        ("seed: -1", "seed: must be a whole number"),
        ("materials: {red: {base_color_texture: c.png}}", "c.png: there is no such file"),
        ("a: [", "random.yaml: isn't YAML"),
        ("- a", "must have keys such as cameras"),
        ("materials: {red: {base_color_texture: {log: [1, 2]}}}", "red: base_color_texture: takes names of files, not"),
        ("environment: {image: [1, 2]}", "environment: image: takes names of files, not"),
        ("instances: {7: {turn: 3}}", "instances: a pattern of names is text, not 7"),
        ("materials: {1: {roughness: 1}}", "materials: a pattern of names is text, not 1"),
        ("cameras:\n  fov: 2020-13-45", "isn't YAML: '2020-13-45' isn't of the kind timestamp.*line 2, column 8: fov"),
        ("seed: !!int x", "isn't YAML: 'x' isn't of the kind int.*line 1"),
        ("seed: !!bool x", "isn't YAML: 'x' isn't of the kind bool"),
        ("cameras: {fov: 40}\ncameras: {roll: 1}", "isn't YAML: the key 'cameras' is there twice.* line 2, column 1"),
        ("seed: true", "seed: must be a whole number from 0 on, not True"),
        ("distractors: {count: true}", "distractors: count: is a number up to 1000, not True"),
        ("distractors: {count: {choose: [2, x]}}", "distractors: count: is a number up to 1000"),
        ("distractors: {count: [3, 1]}", "distractors: count: is a number up to 1000"),
    ],
)
def test_wrong_recipes(make, text, words):
    if words is None:  # a vector of two
        make(text)
        return
    with pytest.raises(SolariError, match=words):
        make(text)


@pytest.mark.parametrize("seed", [-1, 1.5, True, None])
def test_wrong_seeds(make, seed):
    with pytest.raises(SolariError, match=r"random\.yaml: seed: must be a whole number from 0 on"):
        make(seed=seed)


def test_keys_that_are_merged_are_not_there_twice(make):
    scene = box()
    with make("materials: {red: &a {alpha: 0.5, metallic: 0}, '*': {<<: *a, metallic: 1}}").applied(scene, 0):
        assert {(item.metallic, item.alpha) for item in scene.materials} == {(1, 0.5)}


def test_pictures_are_those_that_were_read(make, tmp_path):
    """A file that changes is neither taken from a cache nor rendered under the hash of the old one."""
    scene = box()
    for value in (0.2, 0.8):
        sv.save_image(tmp_path / "a.png", np.full((2, 2, 3), value))
        sv.save_image(tmp_path / "sky.exr", np.full((2, 4, 3), value))
        randomizer = make("materials: {red: {base_color_texture: a.png}}\nenvironment: {image: sky.exr}")
        randomizer.prepare(scene)
        with randomizer.applied(scene, 0):
            pixels = sv.Texture(tmp_path / "a.png").image.pixels
            assert np.array_equal(scene.materials["red"].base_color_texture.image.pixels, pixels)
            np.testing.assert_allclose(scene.environment.image, value, rtol=1e-3)
    for name, other in (("a.png", np.zeros((2, 2, 3))), ("sky.exr", np.zeros((2, 4, 3)))):
        randomizer = make("materials: {red: {base_color_texture: a.png}}\nenvironment: {image: sky.exr}")
        sv.save_image(tmp_path / name, other)
        _texture.cache_clear()
        _radiance.cache_clear()
        words = f"random.yaml: {name}: isn't the picture that it was"
        with pytest.raises(SolariError, match=words), randomizer.applied(scene, 0):
            pass


def test_distractors_are_none_of_the_scenes_objects(make):
    """Names like theirs are refused, or those of usual objects if there are no distractors; one is the default."""
    scene = box()
    own = scene.add(sv.shapes.sphere(0.1), name="distractor of mine")
    before = state(scene)
    with pytest.raises(SolariError, match=r"random\.yaml: distractors: .* has Instance 'distractor of mine' already"):
        make("distractors: {count: 2}").prepare(scene)
    assert state(scene) == before
    plain = make("instances: {'distractor*': {visible: false}}", "plain.yaml")
    plain.prepare(scene)
    with plain.applied(scene, 0):
        assert not own.visible
    own.name = "mine"
    one = make("distractors: {}")
    one.prepare(scene)
    assert set(scene.instances) - set(one.objects(scene)) == {scene.instances["distractor 0"]}
    with one.applied(scene, 0):
        assert scene.instances["distractor 0"].visible


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("instances: {'Chair*': {turn: 3}}", r"random.yaml: instances: nothing is named 'Chair\*'"),
        ("lights: {key: {lumen: 3}}", "lights: key: there is no key 'lumen'; did you mean 'lumens'"),
        ("materials: {red: {roughness: [3, 4]}}", "random.yaml: materials/red/0: .*roughness"),
    ],
)
def test_recipes_that_do_not_fit_the_scene(make, text, words):
    scene, randomizer = box(), make(text)
    before = state(scene)
    with pytest.raises(SolariError, match=words):  # noqa: PT012
        randomizer.prepare(scene)
        with randomizer.applied(scene, 0):
            pass
    assert state(scene) == before


PYTHON = """
import solari_vk as sv

def prepare(scene):
    scene.add(sv.shapes.sphere(0.1), name="ball")

def randomize(scene, random, number):
    scene.instances["ball"].position = random.uniform(0, 2, 3)
    scene.instances["ball"].material = sv.Material(base_color=random.uniform(0, 1, 3))

def camera(camera, random, number):
    camera.fov = random.uniform(30, 60)
"""


def test_python_recipes(make):
    randomizer, scene = make(PYTHON, "random.py"), box()
    randomizer.prepare(scene)
    before, places = state(scene), []
    for number in (3, 4, 3):
        with randomizer.applied(scene, number):
            places.append(tuple(scene.instances["ball"].position))
    assert places[0] == places[2] != places[1]
    assert state(scene) == before
    camera = sv.Camera()
    randomizer.camera(camera, 1)
    assert 30 <= camera.fov <= 60
    for text, words in (
        ("def f(): pass", "random.py: has none of the functions prepare, randomize, camera"),
        ("def randomize(:", "random.py, line 1: SyntaxError"),
        ("\n\nimport nothing_of_this_name", "random.py, line 3: ModuleNotFoundError"),
        ("def randomize(scene, random, number):\n    scene.instances['x']", "random.py, line 2: SolariError: there is"),
        ("def randomize(scene, random, number):\n    scene.remove(scene.instances[0])", "add them in prepare"),
    ):
        with pytest.raises(SolariError, match=words), make(text, "random.py").applied(scene, 0):
            pass
        assert state(scene) == before


JUNK = (
    None,
    3,
    -1,
    1e300,
    True,
    "x",
    "a.png",
    [],
    [1],
    [1, 2],
    [[0, 0], [1, 1]],
    [[0, 0, 0], [1, 1, 1]],
    {},
    {1: 2},
    {"choose": [None]},
    {"choose": ["x", [1, 2, 3]]},
    {"log": [1, 2]},
    float("inf"),
    [[None]],
    {"choose": {}},
)


def mutants(value, path=()):
    """Every recipe that differs from this one in one value or key."""
    if isinstance(value, dict):
        for key, inner in value.items():
            for mutant in mutants(inner, (*path, key)):
                yield {**value, key: mutant}
        yield {**value, 7: 1}
    yield from JUNK


def test_any_recipe_works_or_names_its_file(make):
    """None leads to another error, or leaves the scene changed."""
    scene, messages = box(), []
    make().prepare(scene)
    before = state(scene)
    recipes = list(mutants(yaml.safe_load(RECIPE)))
    for number in np.random.default_rng(1).permutation(len(recipes))[:250].tolist():
        try:
            randomizer = make(yaml.safe_dump(recipes[number]))
            with randomizer.applied(scene, number):
                pass
            randomizer.camera(sv.Camera(), number)
        except SolariError as error:
            messages.append(str(error))
        assert state(scene) == before, recipes[number]
    assert 50 < len(messages) < 240
    assert [text for text in messages if "random.yaml" not in text and "no such file" not in text] == []


def test_draws():
    random = np.random.default_rng(1)
    assert draw(True, random) is True
    assert draw([1, 2, 3], random) == [1, 2, 3]
    assert draw("a", random) == "a"
    values = [draw({"log": [0.01, 1]}, random) for _ in range(2000)]
    assert abs(np.median(values) - 0.1) < 0.02
    assert {draw(["a", "b"], random) for _ in range(20)} == {"a", "b"}
    for wrong in ({"choose": []}, {"choose": [1], "log": [1, 2]}, [], [None], {"log": 3}, float("nan"), [[0], [1, 2]]):
        with pytest.raises(SolariError, match="place"):
            check(wrong, "place")
