"""Random scenes by a recipe: a YAML file, or functions of a Python file."""

from __future__ import annotations

import hashlib
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import Hints, SolariError, checked_constructor
from solari_vk.base.files import open_regular, read_regular
from solari_vk.data.randomize.draws import stream
from solari_vk.data.randomize.recipe import Recipe, check_recipe, files_of
from solari_vk.scene.checks import check_whole
from solari_vk.scene.collection import Items
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.observable import Checked

LARGEST_RECIPE = 2**20  # bytes: PyYAML reads some 100 KB a second
FUNCTIONS = ("prepare", "randomize", "camera")


@checked_constructor
@dataclass(frozen=True)
class Randomizer(Hints):
    """Makes a random scene for each picture, which the seed and the picture's number alone decide.

    `Randomizer.load("random.yaml", seed=3)` reads a recipe: the guide "A data set in ten minutes" says what may stand
    there. A Python file has at least one of the functions prepare(scene), which may add objects; randomize(scene,
    random, number), which may change all fields of objects; and camera(camera, random, number). random: numpy's
    Generator of the picture.
    """

    path: str = field(compare=False)
    text: str
    seed: int = 0
    files: tuple[tuple[str, str], ...] = ()
    """The recipe's pictures, with the SHA-256 of each."""

    @classmethod
    def load(cls, path: str | os.PathLike[str], seed: int = 0) -> Randomizer:
        """Read and check a recipe. seed: a whole number from 0 on; a YAML file's own comes first.

        Raises SolariError for a file or a picture that can't be read, and for unknown keys and wrong values, which it
        names with the file and the nearest key.
        """
        file = Path(path).absolute()
        check_whole(f"{path}: seed:", seed)
        try:
            with load_budget():
                text = read_regular(file, f"{path}", LARGEST_RECIPE + 1).decode()
        except UnicodeDecodeError:
            raise SolariError(f"{path}: isn't text: give a .yaml or a .py file") from None
        if len(text) > LARGEST_RECIPE:
            raise SolariError(f"{path}: a recipe has at most {LARGEST_RECIPE >> 20} MiB")
        if file.suffix == ".py":
            _functions(str(file), text)
            return cls(str(file), text, seed)
        recipe = _read(str(file), text)
        # With the hashes a worker, or a later run into the same folder, notices that a picture was replaced.
        sums = []
        for name in files_of(recipe):
            with open_regular(file.parent / name, f"{path}: {name}") as picture:
                sums.append((name, hashlib.file_digest(picture, "sha256").hexdigest()))
        return cls(str(file), text, recipe.get("seed", seed), tuple(sums))

    @property
    def _recipe(self) -> Any:
        """What does the work. It is made anew from the text each time, because workers get a pickled Randomizer."""
        if self.path.endswith(".py"):
            return _Functions(self.path, self.text, self.seed)
        path = Path(self.path)
        return Recipe(_read(self.path, self.text), path.name, path.parent, self.seed, dict(self.files))

    def prepare(self, scene: Scene) -> None:
        """Add the objects that pictures show or hide.

        Raises SolariError for patterns that fit nothing, and for a scene that has objects of distractors' names.
        """
        self._recipe.prepare(scene)

    def objects(self, scene: Scene) -> list[Instance]:
        """The instances of a prepared scene that have labels: all but distractors."""
        found: list[Instance] = self._recipe.objects(scene)
        return found

    @contextmanager
    def applied(self, scene: Scene, number: int) -> Iterator[None]:
        """Change a prepared scene as picture `number` has it, and back at the end."""
        snapshot = _Snapshot(scene)
        try:
            self._recipe.randomize(scene, number)
            snapshot.check_members(Path(self.path).name)
            yield
        finally:
            snapshot.restore()

    def camera(self, camera: Camera, number: int) -> None:
        """Change the camera of picture `number`."""
        self._recipe.camera(camera, number)


@lru_cache(maxsize=8)
def _read(path: str, text: str) -> Any:
    try:
        from solari_vk.data.randomize.strict_yaml import read_yaml
    except ImportError:
        raise SolariError(f"{path}: YAML is read by the package pyyaml: pip install solari-vk[dataset]") from None
    who = Path(path).name
    with load_budget():
        recipe = read_yaml(text, who)
    check_recipe(recipe, who)
    return recipe


@lru_cache(maxsize=8)
def _functions(path: str, text: str) -> dict[str, Any]:
    # Executed from the text and not imported: a worker may not have the file, and the text is what the journal hashes.
    space: dict[str, Any] = {"__name__": "randomizer", "__file__": path}
    with _naming_the_line(path):
        exec(compile(text, path, "exec"), space)
    found = {name: space[name] for name in FUNCTIONS if callable(space.get(name))}
    if not found:
        raise SolariError(f"{Path(path).name}: has none of the functions {', '.join(FUNCTIONS)}")
    return found


@contextmanager
def _naming_the_line(path: str) -> Iterator[None]:
    """Turn what a user's code raises into an error that names its file and line."""
    try:
        yield
    except Exception as error:
        # The deepest line of the user's own file; a syntax error has no frame there but names its line itself.
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
        line = lines[-1] if lines else getattr(error, "lineno", None)
        raise SolariError(f"{Path(path).name}, line {line}: {type(error).__name__}: {error}") from error


class _Functions:
    """The functions of a Python file at work."""

    def __init__(self, path: str, text: str, seed: int) -> None:
        self._functions = _functions(path, text)
        self._path = path
        self._seed = seed

    def _call(self, name: str, *arguments: Any) -> None:
        if name in self._functions:
            with _naming_the_line(self._path):
                self._functions[name](*arguments)

    def _random(self, number: int, name: str) -> np.random.Generator:
        return stream(self._seed, number, name)

    def prepare(self, scene: Scene) -> None:
        self._call("prepare", scene)

    def objects(self, scene: Scene) -> list[Instance]:
        return list(scene.instances)

    def randomize(self, scene: Scene, number: int) -> None:
        self._call("randomize", scene, self._random(number, "scene"), number)

    def camera(self, camera: Camera, number: int) -> None:
        self._call("camera", camera, self._random(number, "camera"), number)


class _Snapshot:
    """A scene as it was: the fields of its instances, meshes, materials and lights."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        # The lists and the fields hold references, not copies: arrays of scene objects are read-only.
        self._members = list(scene.instances), list(scene.lights)
        objects: list[Checked] = [*scene.instances, *scene.meshes, *scene.materials, *scene.lights]
        self._fields = [(item, {name: getattr(item, name) for name in type(item)._names}) for item in objects]

    def check_members(self, who: str) -> None:
        """Raise SolariError if instances or lights were added or removed."""
        if (list(self._scene.instances), list(self._scene.lights)) != self._members:
            raise SolariError(
                f"{who}: adds or removes instances or lights: add them in prepare(scene), and change "
                "their visible or intensity here"
            )

    def restore(self) -> None:
        """Give all fields the values that they had, and take away what was added."""
        instances, lights = self._members
        if list(self._scene.instances) != instances:
            _refill(self._scene.instances, instances)
        if list(self._scene.lights) != lights:
            _refill(self._scene.lights, lights)
        # Only what differs is assigned, because each assignment makes the device's copy stale.
        for item, fields in self._fields:
            changed = {name: value for name, value in fields.items() if getattr(item, name) is not value}
            if changed:
                item.update(**changed)


def _refill(items: Items[Any], members: list[Any]) -> None:
    items.clear()
    for member in members:
        items.add(member)
