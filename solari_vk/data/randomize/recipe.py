"""Recipes of random scenes as YAML says them: what may stand where, and what it does to a scene."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.base.files import read_regular
from solari_vk.data.randomize.draws import check, draw, is_numbers, largest, stream
from solari_vk.scene import shapes
from solari_vk.scene.checks import check_whole
from solari_vk.scene.images.image_files import read_pixels
from solari_vk.scene.images.radiance_files import read_radiance
from solari_vk.scene.matrices import rotation, transform_points
from solari_vk.scene.model import Camera, Environment, Instance, Material, Scene, Texture, TextureImage
from solari_vk.scene.objects import fits, objects_of
from solari_vk.scene.observable import Checked
from solari_vk.scene.placement import PARTS

MOST_DISTRACTORS = 1000
PREFIX = "distractor "  # of their names: workers get the scene without being told which objects were added
DISTRACTORS = ("count", "shapes", "size", "within", "material")
SHAPES = ("box", "sphere", "cylinder", "cone", "capsule", "torus")
RELATIVE: dict[str, tuple[str, ...]] = {
    "cameras": ("offset", "target", "ev", "roll"),
    "instances": ("offset", "turn"),
    "materials": (),
    "lights": ("offset", "brightness"),
    "environment": ("turn", "brightness"),
}
SECTIONS = ("seed", *RELATIVE, "distractors")
PATTERNS = ("instances", "materials", "lights")


def check_recipe(recipe: Any, who: str) -> None:
    """Raise SolariError for a recipe with a key or a value that there isn't, which names the nearest key."""
    if not isinstance(recipe, Mapping):
        raise SolariError(f"{who}: must have keys such as {', '.join(SECTIONS[1:])}, not {quoted(recipe)}")
    _check_keys(recipe, SECTIONS, who)
    _check_values(recipe.get("cameras", {}), f"{who}: cameras", _known("cameras", Camera))
    _check_values(recipe.get("environment", {}), f"{who}: environment", _known("environment", Environment))
    for name in PATTERNS:
        _check_patterns(name, recipe.get(name, {}), f"{who}: {name}")
    _check_distractors(recipe.get("distractors", {}), f"{who}: distractors")
    check_whole(f"{who}: seed:", recipe.get("seed", 0))


def _check_patterns(section: str, patterns: Any, place: str) -> None:
    """Check a section in which patterns of names have keys and values."""
    if not isinstance(patterns, Mapping):
        raise SolariError(f'{place}: must have patterns of names, such as "Chair*", not {quoted(patterns)}')
    # Which keys a light has depends on its kind, and so on the scene: `prepare` checks them.
    known = {"instances": _known(section, Instance), "materials": _known(section, Material)}.get(section)
    for pattern, values in patterns.items():
        if not isinstance(pattern, str):
            raise SolariError(f"{place}: a pattern of names is text, not {quoted(pattern)}: put it in quotes")
        _check_values(values, f"{place}: {pattern}", known)


def _check_distractors(section: Any, place: str) -> None:
    own_values = {name: value for name, value in _mapping(section, place).items() if name != "material"}
    _check_values(own_values, place, DISTRACTORS)
    _check_values(section.get("material", {}), f"{place}: material", _known("materials", Material))
    shapes_given = section.get("shapes", [])
    if isinstance(shapes_given, Mapping):
        shapes_given = shapes_given.get("choose", [None])
    for shape in shapes_given if isinstance(shapes_given, list) else [shapes_given]:
        if shape not in SHAPES:
            raise unknown_name(f"{place}: shapes: there is no shape", shape, SHAPES)
    _check_count(section.get("count", 1), f"{place}: count")
    if "within" in section and np.shape(section["within"]) != (2, 3):
        raise SolariError(f"{place}: within: is a box, [[x, y, z], [x, y, z]], not {quoted(section['within'])}")


def _check_count(count: Any, place: str) -> None:
    """Raise SolariError unless a value and all that is drawn from it are numbers up to MOST_DISTRACTORS."""
    counts = next(iter(count.values())) if isinstance(count, Mapping) else count
    # A trial draw tells a number from a vector, whatever distribution it is drawn from.
    is_number = is_numbers(counts) and np.ndim(draw(count, stream(0, 0, ""))) == 0
    if not is_number or largest(count) > MOST_DISTRACTORS:
        raise SolariError(f"{place}: is a number up to {MOST_DISTRACTORS}, not {quoted(count)}")


def _known(section: str, kind: type[Checked]) -> tuple[str, ...]:
    """The keys of a section: relative changes, and the fields of its objects."""
    # Names and labels are what patterns and annotations go by: pictures don't change them.
    fields = (name for name in kind._names if name not in ("name", "label", "part_of"))
    return (*RELATIVE[section], *fields, *kind._aliases, *kind._derived)


def _mapping(section: Any, place: str) -> Mapping[str, Any]:
    if not isinstance(section, Mapping):
        raise SolariError(f"{place}: must have keys and values, not {quoted(section)}")
    return section


def _check_keys(section: Mapping[Any, Any], known: Iterable[str], place: str) -> None:
    for name in section:
        if name not in known:
            raise unknown_name(f"{place}: there is no key", name, known)


def _check_values(section: Any, place: str, known: tuple[str, ...] | None) -> None:
    """known: None if that depends on the scene."""
    if known is not None:
        _check_keys(_mapping(section, place), known, place)
    for name, value in _mapping(section, place).items():
        check(value, f"{place}: {name}")
        if _is_picture(name) and not all(one is None or isinstance(one, str) for one in _choices(value)):
            raise SolariError(f"{place}: {name}: takes names of files, not {quoted(value)}")


def _is_picture(name: Any) -> bool:
    """Whether the values of a key are names of files."""
    return isinstance(name, str) and (name == "image" or name.endswith("_texture"))


def _choices(value: Any) -> list[Any]:
    """The values that a picture's key gives one of."""
    choices = next(iter(value.values())) if isinstance(value, Mapping) else value
    return choices if isinstance(choices, list) else [choices]


def files_of(recipe: Mapping[str, Any]) -> list[str]:
    """The names of the pictures that a recipe takes."""
    places = [
        recipe.get("environment", {}),
        recipe.get("distractors", {}).get("material", {}),
        *recipe.get("materials", {}).values(),
    ]
    found = dict[str, None]()
    for values in places:
        for name, value in values.items():
            if _is_picture(name):
                found |= dict.fromkeys(one for one in _choices(value) if one is not None)
    return list(found)


# ---- what a recipe does -----------------------------------------------------------------------------


class Recipe:
    """A checked recipe at work. who: the file, for messages. files: the SHA-256 of its pictures, by their names."""

    def __init__(self, recipe: Mapping[str, Any], who: str, folder: Path, seed: int, files: Mapping[str, str]) -> None:
        self._recipe = recipe
        self._who = who
        self._folder = folder
        self._seed = seed
        self._files = files

    def prepare(self, scene: Scene) -> None:
        """Add what pictures show or hide: distractors, and an environment; check the patterns and the lights' keys."""
        if "distractors" in self._recipe:
            self._add_distractors(scene)
        if "environment" in self._recipe and not isinstance(scene.environment, Environment):
            scene.environment = Environment(0.0)
        for section in PATTERNS:
            for pattern, values in self._recipe.get(section, {}).items():
                self._check_pattern(scene, section, pattern, values)

    def _add_distractors(self, scene: Scene) -> None:
        """Add as many hidden objects as a picture shows at most: pictures change objects, and never their number."""
        named = [item for item in scene.instances if item.name.startswith(PREFIX)]
        if named:
            raise SolariError(
                f"{self._who}: distractors: {scene.describe()} has {named[0].describe()} already: "
                f"prepare a scene once, and call its own objects otherwise"
            )
        most = math.ceil(largest(self._recipe["distractors"].get("count", 1)))
        for number in range(max(most, 0)):
            scene.add(Instance(_shape("box"), name=f"{PREFIX}{number}", visible=False))

    def _check_pattern(self, scene: Scene, section: str, pattern: str, values: Mapping[str, Any]) -> None:
        """Raise SolariError for a pattern that fits nothing, and for keys that the lights it fits don't have."""
        place = f"{self._who}: {section}"
        items = self._items(scene, section)
        fitting = [item for item in items if fits(item, pattern, scene.backdrop)]
        if not fitting:
            raise unknown_name(f"{place}: nothing is named", pattern, [item.name for item in items])
        if section == "lights":
            for light in fitting:
                _check_keys(values, _known("lights", type(light)), f"{place}: {pattern}")

    def objects(self, scene: Scene) -> list[Instance]:
        """The instances that aren't distractors."""
        is_mixed = "distractors" in self._recipe
        return [item for item in scene.instances if not (is_mixed and item.name.startswith(PREFIX))]

    def _items(self, scene: Scene, section: str) -> list[Any]:
        if section == "instances":
            return self.objects(scene)
        if section == "materials":
            return list(dict.fromkeys(item.material for item in self.objects(scene)))
        return [light for light in scene.lights if light is not scene.environment]

    def randomize(self, scene: Scene, number: int) -> None:
        """Change a prepared scene as picture `number` has it."""
        for section in PATTERNS:
            for pattern, values in self._recipe.get(section, {}).items():
                items = enumerate(self._items(scene, section))
                fitting = {index: item for index, item in items if fits(item, pattern, scene.backdrop)}
                # One draw for all parts of an object, which move as one.
                parts = objects_of(fitting) if section == "instances" else {index: [index] for index in fitting}
                for index, others in parts.items():
                    place = f"{section}/{pattern}/{index}"
                    self._apply(fitting[index], values, number, place, [fitting[other] for other in others[1:]])
        if "environment" in self._recipe:
            self._apply(scene.environment, self._recipe["environment"], number, "environment")
        if "distractors" in self._recipe:
            self._place_distractors(scene, number)

    def camera(self, camera: Camera, number: int) -> None:
        """Change the camera of picture `number`."""
        self._apply(camera, self._recipe.get("cameras", {}), number, "cameras")

    def _draw(self, value: Any, number: int, place: str) -> Any:
        return draw(value, stream(self._seed, number, place))

    def _apply(
        self, item: Any, values: Mapping[str, Any], number: int, place: str, others: Sequence[Instance] = ()
    ) -> None:
        """others: further parts of an instance's object, which move with it."""
        drawn = {name: self._draw(value, number, f"{place}/{name}") for name, value in values.items()}
        fields = {name: self._read(name, value) for name, value in drawn.items() if name not in _RELATIVELY}
        with self._naming_the_recipe(place):
            with _followed(item, others):
                item.update(**fields)
            # Other parts have followed the transform; the rest of the fields is theirs too.
            shared = {name: value for name, value in fields.items() if name not in ("transform", *PARTS)}
            for other in others:
                other.update(**shared)
            for name, change in _RELATIVELY.items():
                if name in drawn:
                    with _followed(item, others):
                        change(item, drawn[name], *others)

    def _read(self, name: str, value: Any) -> Any:
        """A value, or what the picture holds whose file it names."""
        if not _is_picture(name) or value not in self._files:
            return value
        # The image of an environment is radiance; the pictures of textures are colors of 8 bits.
        read = _radiance if name == "image" else _texture
        return read(self._folder / value, self._files[value], f"{self._who}: {value}")

    @contextmanager
    def _naming_the_recipe(self, place: str) -> Iterator[None]:
        """Name the recipe in errors of values that objects refuse."""
        try:
            yield
        except (SolariError, TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"{self._who}: {place}: {error}") from None

    def _place_distractors(self, scene: Scene, number: int) -> None:
        section = {"count": 1, "shapes": list(SHAPES), "size": 0.1, "material": {}, **self._recipe["distractors"]}
        added = [item for item in scene.instances if item.name.startswith(PREFIX)]
        placed = [item for item in self.objects(scene) if item is not scene.backdrop]
        low, high = section["within"] if "within" in section else _bounds(placed)
        count = round(self._draw(section["count"], number, "distractors/count"))
        for index, item in enumerate(added[: max(count, 0)]):
            place = f"distractors/{index}"
            random = stream(self._seed, number, place)
            # Four normal numbers as a unit quaternion: a uniform rotation (Shoemake, "Uniform Random Rotations", 1992).
            turn = random.normal(size=4)
            with self._naming_the_recipe(place):
                item.update(
                    mesh=_shape(self._draw(section["shapes"], number, f"{place}/shape")),
                    visible=True,
                    position=random.uniform(low, high),
                    rotation=(turn / np.linalg.norm(turn)).tolist(),
                    scale=self._draw(section["size"], number, f"{place}/size"),
                    material=Material(name=item.name),
                )
            self._apply(item.material, section["material"], number, f"{place}/material")


def _bounds(items: Iterable[Instance]) -> Any:
    return Scene(*(Instance(item.mesh, transform=item.transform) for item in items)).bounds


@contextmanager
def _followed(item: Any, others: Sequence[Instance]) -> Iterator[None]:
    """Move the others as the item is moved within."""
    back = np.linalg.inv(item.transform) if others else np.eye(4)
    yield
    # The movement in the world, which takes the first part from its old place to the new one, takes the others too.
    for other in others:
        other.transform = item.transform @ back @ other.transform


def _move(item: Any, offset: Any, *_: Instance) -> None:
    item.position = np.asarray(item.position, np.float64) + offset


def _turn(item: Any, degrees: float, *others: Instance) -> None:
    """About the vertical axis through the middle of an object's box: files may have it far from its origin."""
    about = rotation((0, 1, 0), math.radians(degrees))
    if not isinstance(item, Instance):
        item.rotation = about @ item.rotation
        return
    # The box is along the object's own axes, so that its middle doesn't depend on how the object is turned.
    into = np.linalg.inv(item.transform)
    points = np.concatenate(
        [
            transform_points(into @ part.transform, part.posed_mesh().positions.astype(np.float64))
            for part in (item, *others)
        ]
    )
    middle = transform_points(item.transform, (points.min(axis=0) + points.max(axis=0)) / 2)
    move = np.eye(4)
    move[:3, :3] = about
    move[:3, 3] = middle - about @ middle
    item.transform = move @ item.transform


def _aim(camera: Any, target: Any) -> None:
    """Turn the camera, where it is by then, towards a point. Raises SolariError if the camera is at that point."""
    camera.place(camera.position, target)


def _roll(camera: Any, degrees: float) -> None:
    camera.rotation = camera.rotation @ rotation((0, 0, 1), math.radians(degrees))


def _brighten(light: Any, factor: float) -> None:
    name = "illuminance" if "illuminance" in type(light)._names else "intensity"
    light.update(**{name: getattr(light, name) * factor})


def _expose(camera: Any, stops: float) -> None:
    camera.ev100 = camera.ev100 + stops


_RELATIVELY: dict[str, Callable[..., None]] = {
    "offset": _move,
    "turn": _turn,
    "target": _aim,
    "roll": _roll,
    "brightness": _brighten,
    "ev": _expose,
}
"""In the order in which they are applied."""


@lru_cache(maxsize=64)
def _texture(path: Path, sha256: str, who: str) -> Texture:
    return Texture(TextureImage(read_pixels(path, _content(path, sha256, who))))


@lru_cache(maxsize=16)
def _radiance(path: Path, sha256: str, who: str) -> Any:
    return read_radiance(path, _content(path, sha256, who))


def _content(path: Path, sha256: str, who: str) -> bytes:
    """The content of a picture that is the one which was there when the recipe was read."""
    data = read_regular(path, who)
    if hashlib.sha256(data).hexdigest() != sha256:
        raise SolariError(f"{who}: isn't the picture that it was when the recipe was read: read the recipe again")
    return data


@lru_cache
def _shape(name: str) -> Any:
    """A shape that fits into a cube of 1 m."""
    made = {
        "sphere": lambda: shapes.sphere(0.5),
        "capsule": lambda: shapes.capsule(0.25, 0.5),
        "torus": lambda: shapes.torus(0.35, 0.15),
    }
    return made.get(name, getattr(shapes, name))()
