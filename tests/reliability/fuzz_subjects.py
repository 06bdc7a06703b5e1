"""The kinds of files that are mutated or made, and command lines, each with how it is written and read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_bombs import BOMBS
from fuzz_commands import command_line, prepare, run_command
from fuzz_mutants import mutate_bytes, mutate_json, mutate_text
from fuzz_seeds import GLTF, IMAGES, MESHES, MTL, RADIANCE, mesh_file
from hypothesis import strategies as st
from support.files import GltfWriter, image_file

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.cli.loading import _find_camera
from solari_vk.data.cluster import RenderTask, Style, View
from solari_vk.data.datasets.dataset import cameras_for, views_of, write_transforms
from solari_vk.data.datasets.journal import Journal
from solari_vk.output.animation import load_path
from solari_vk.scene.files.gltf.saving.content import glb

RANDOMS = st.randoms(use_true_random=False)
Write = Callable[[random.Random], object]


@dataclass(frozen=True)
class Subject:
    """A file in a folder, written as it should be.

    load: read it and check what was read. write: put a mutant of it in its place, by what hypothesis draws from
    `changes`. named: how every error begins. seconds: that loading may take. grows: hypothesis looks for those that
    take the most memory for their size. anywhere: files outside the folder may be opened.
    """

    load: Callable[[], object]
    write: Callable[[Any], object]
    named: str | tuple[str, ...]
    changes: st.SearchStrategy[Any] = RANDOMS
    seconds: int = 5
    grows: bool = False
    anywhere: bool = False


def open_subject(kind: str, folder: Path) -> Subject:
    """The subject of a kind in an empty folder."""
    if kind in GLTF:
        return _gltf(GLTF[kind](), folder / "mutant.glb")
    if kind in MESHES:
        return _mesh(kind, folder / f"mutant.{kind.rpartition('.')[2]}")
    if kind in IMAGES:
        return _image(IMAGES[kind](), folder / "mutant.glb")
    if kind in RADIANCE:
        return _environment(RADIANCE[kind](folder), folder / f"mutant.{kind}")
    if kind in BOMBS:
        return _bomb(kind, folder)
    if kind == "commands":
        return _commands(folder)
    others = {"external": _external, "camera": _camera, "path": _path, "transforms": _transforms, "journal": _journal}
    return others[kind](folder)


# ---- scenes -----------------------------------------------------------------------------------------


def _load(path: Path, **options: Any) -> None:
    """Load a scene, pose it at some times of each clip, of which some may be refused, and look at its images."""
    scene = sv.load(path, **options)
    for clip in range(len(scene.animations)):
        for seconds in (0.0, 0.3, 7.0):
            with contextlib.suppress(SolariError):
                scene.animate(seconds, clip, loop=False)
    for instance in scene:
        assert np.isfinite(instance.posed_mesh().positions).all()
        for texture in (instance.material.base_color_texture, instance.material.emissive_texture):
            assert texture is None or texture.image.pixels.size
    str(scene.warnings).encode()


def _gltf(writer: GltfWriter, path: Path) -> Subject:
    """A .glb file with random changes in its JSON, in its binary part, or anywhere."""
    whole = writer.glb()
    path.write_bytes(whole)

    def write(generator: random.Random) -> None:
        kind = generator.random()
        if kind < 0.55:
            path.write_bytes(glb(mutate_json(writer.json, generator), bytes(writer.data)))
        elif kind < 0.75:  # the binary part only, which the checks of the JSON don't cover
            path.write_bytes(glb(json.dumps(writer.json).encode(), mutate_bytes(bytes(writer.data), generator)))
        else:
            path.write_bytes(mutate_bytes(whole, generator))

    return Subject(lambda: _load(path), write, str(path))


def _external(folder: Path) -> Subject:
    """A .gltf file with a .bin file beside it."""
    path = GLTF["gltf"]().save(folder / "mutant.gltf", "external")
    content = json.loads(path.read_bytes())
    beside = folder / content["buffers"][0]["uri"]
    data = beside.read_bytes()

    def write(generator: random.Random) -> None:
        path.write_bytes(mutate_json(content, generator) if generator.random() < 0.7 else json.dumps(content).encode())
        beside.write_bytes(mutate_bytes(data, generator) if generator.random() < 0.5 else data)

    return Subject(lambda: _load(path), write, str(path))


def _image(files: Sequence[tuple[bytes, str]], path: Path) -> Subject:
    """A scene with one image, of which only the bytes change. files: with the extension that names the image."""

    def save(file: bytes, extension: str) -> None:
        writer = GltfWriter()
        image = {"source": writer.add("images", bufferView=writer.view(file))}
        named = {"extensions": {extension: image}} if extension else image
        texture = writer.add("textures", **named)
        writer.add("materials", emissiveTexture={"index": texture}, emissiveFactor=[1, 1, 1])
        writer.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]]}, material=0)
        path.write_bytes(writer.glb())

    def write(generator: random.Random) -> None:
        file, extension = generator.choice(files)
        save(mutate_bytes(file, generator), extension)

    save(*files[0])
    return Subject(lambda: _load(path, strict=True), write, str(path))


def _mesh(kind: str, path: Path) -> Subject:
    data = mesh_file(kind)
    materials = path.with_name("model.mtl")
    picture = image_file(np.zeros((2, 2, 3)))
    path.write_bytes(data)
    materials.write_bytes(MTL)
    path.with_name("wood.png").write_bytes(picture)

    def write(generator: random.Random) -> None:
        which = generator.random() if kind == "obj" else 0.0
        path.write_bytes(mutate_text(data, generator) if which < 0.6 else data)
        materials.write_bytes(mutate_text(MTL, generator) if 0.5 < which < 0.9 else MTL)
        path.with_name("wood.png").write_bytes(mutate_bytes(picture, generator) if which > 0.85 else picture)

    return Subject(lambda: _load(path), write, str(path))


def _environment(files: Sequence[bytes], path: Path) -> Subject:
    path.write_bytes(files[0])

    def load() -> None:
        image = sv.Environment(path).image
        assert np.isfinite(image).all()
        assert image.min() >= 0

    def write(generator: random.Random) -> None:
        path.write_bytes(mutate_bytes(generator.choice(files), generator))

    return Subject(load, write, str(path))


# ---- what the command line reads and writes -----------------------------------------------------------


def _json(path: Path, content: Any) -> Write:
    text = json.dumps(content, indent=1).encode()
    path.write_bytes(text)
    return lambda generator: path.write_bytes(
        mutate_json(content, generator) if generator.random() < 0.7 else mutate_text(text, generator)
    )


def _check(cameras: Sequence[sv.Camera]) -> None:
    assert all(np.isfinite(camera.transform).all() and 0 < camera.vertical_fov < np.pi for camera in cameras)


POSE = {"position": [1, 1, -2.4], "target": [1.0, 1, 1], "up": [0, 1, 0], "vertical_fov_degrees": 40, "ev100": 1.5}


def _camera(folder: Path) -> Subject:
    path, scene = folder / "camera.json", sv.builtin("cornell_box")
    return Subject(lambda: _check([_find_camera(scene, str(path))]), _json(path, POSE), f"--camera {path}")


def _path(folder: Path) -> Subject:
    path, camera = folder / "path.json", sv.builtin("cornell_box").camera
    last = {"time": 2, "transform": camera.transform.tolist()}
    poses = [{"time": 0, **POSE}, {"time": 1.5, **POSE, "ev100": 2}, last]
    return Subject(lambda: _check(load_path(path, camera, fps=4)), _json(path, poses), str(path))


def _transforms(folder: Path) -> Subject:
    path, scene = folder / "transforms.json", sv.builtin("cornell_box")
    write_transforms(folder, Style((6, 4), layers=("depth",)), views_of([scene.camera] * 3, ".png"))
    write = _json(path, json.loads(path.read_bytes()))
    return Subject(
        lambda: _check(cameras_for(str(path), scene, scene.camera, None, 1.5, 0)), write, f"--cameras {path}"
    )


def _journal(folder: Path) -> Subject:
    path = folder / "views.jsonl"
    camera = sv.builtin("cornell_box").camera
    style = Style((6, 4))
    tasks = [RenderTask(style, number, (View(f"{number}.npy", camera),)) for number in range(3)]
    made_of = {"scene": "abc", "style": style}
    journal = Journal(path, made_of)
    for task in tasks:
        (folder / task.files[0]).write_bytes(b"picture")
        journal.record(task, {task.files[0]: hashlib.sha256(b"picture").hexdigest()})
    whole = path.read_bytes()
    lines = [json.loads(line) for line in whole.splitlines()]

    def load() -> None:
        journal = Journal(path, made_of)
        journal.check(tasks)
        for task in tasks:
            if not journal.has(task):
                journal.record(task, {task.files[0]: hashlib.sha256(b"picture").hexdigest()})
        assert all(Journal(path, made_of).has(task) for task in tasks)

    def write(generator: random.Random) -> None:
        if generator.random() < 0.5:
            path.write_bytes(mutate_text(whole, generator))
            return
        at = generator.randrange(len(lines))
        texts = [json.dumps(line).encode() for line in lines]
        texts[at] = mutate_json(lines[at], generator)
        path.write_bytes(b"\n".join(texts) + b"\n")

    return Subject(load, write, str(folder))


# ---- bombs and command lines --------------------------------------------------------------------------


def _bomb(kind: str, folder: Path) -> Subject:
    """Files whose loading takes as much as it can; at first an empty one, which is refused."""
    scene = sv.builtin("cornell_box")
    path = folder / "bomb.stl"
    path.write_bytes(
        b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
        b"endfacet\nendsolid\n"
    )

    def write(data: st.DataObject) -> None:
        nonlocal path
        path = BOMBS[kind](data.draw, folder)

    def load() -> None:
        if path.suffix == ".json":
            if path.read_bytes()[-30:].count(b"time"):
                load_path(path, scene.camera, fps=24)
            else:
                cameras_for(str(path), scene, scene.camera, None, 1.5, 0)
        elif path.suffix in (".hdr", ".exr"):
            sv.Environment(path)
        else:
            sv.load(path)

    return Subject(load, write, (str(folder), f"--cameras {folder}"), st.data(), seconds=20, grows=True)


def _commands(folder: Path) -> Subject:
    """Command lines in a folder with a few files, on a machine without a device: rendering doesn't begin."""
    prepare(folder)
    words = ["views"]

    def write(data: st.DataObject) -> None:
        words[:] = command_line(data.draw)

    return Subject(lambda: run_command(words), write, "", st.data(), seconds=20, anywhere=True)
