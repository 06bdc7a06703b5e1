"""Saves what the viewer shows: the scene as glTF, and a script in Python that renders the picture from it."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, write_whole
from solari_vk.scene.files.gltf.saving.content import data_path_of
from solari_vk.scene.model import Scene
from solari_vk.scene.placement import Placed
from solari_vk.settings import DEFAULTS
from solari_vk.studio.viewer.history import Assignment
from solari_vk.studio.viewer.refinement import FRAMES, SAMPLES
from solari_vk.studio.viewer.session import Session

# Fields that clips change.
PLACES = ("transform", "position", "rotation", "scale", "direction", "horizontal", "center", "half_u", "half_v")


def free_path(session: Session) -> Path:
    """A path in the session's folder where there is no file yet, for `save_scene`."""
    stem = Path(session.name or "scene").stem.replace(":", "-") or "scene"
    for number in itertools.count(1):
        path = session.folder / f"{stem}-{number:03}.glb"
        if not path.exists() and not path.with_suffix(".py").exists():
            break
    return path


def files_of(path: Path) -> tuple[Path, ...]:
    """The files that `save_scene` writes for a path. Raises SolariError for another ending than .glb and .gltf."""
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise SolariError(f"{path}: give a name that ends in .glb or .gltf")
    # A .gltf file has its vertices and animations in a .bin file, a .glb file has them inside.
    data = [data_path_of(path)] if path.suffix.lower() == ".gltf" else []
    return (path, path.with_suffix(".py"), *data)


def save_scene(session: Session, path: Path) -> tuple[Path, list[str]]:
    """Write the scene to a .glb or .gltf file, and beside it the script, whose path is returned with what the file
    can't hold. Raises SolariError for another ending, and if a file can't be written."""
    _, script, *_ = files_of(path)
    make_folder(path.parent)
    # Saving warns about what glTF can't hold; the viewer tells the user, as a part of its own message.
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        session.scene.save(path)
    lines, lost = _animated_edits(session)
    write_whole(script, script_text(session, path.name, lines))
    return script, [*(str(warning.message) for warning in noted), *lost]


def _animated_edits(session: Session) -> tuple[list[str], list[str]]:
    """Assignments that place what was edited as it is now, of what clips place otherwise, and so the file does; and
    which of it has no name that a script could call it by."""
    # Dictionaries as ordered sets: an object that was edited several times is written once, as it is now.
    lines = dict[str, None]()
    lost = dict[str, None]()
    rigs = [clip.rig for clip in session.scene.animations]
    animated = {item for rig in rigs for item, *_ in (*rig.placed, *rig.skins, *rig.weighted)}
    edits = [edit for edit in session.history if isinstance(edit, Assignment) and edit.item in animated]
    for edit in edits:
        expression = _named_expression(session.scene, edit.item)
        for name in _animated_fields(edit):
            if expression:
                lines[f"{expression}.{name} = {np.asarray(getattr(edit.item, name)).tolist()!r}"] = None
            elif expression is not None:
                lost[f"the {name} of {edit.item.describe()}, which follows clips and has no name of its own"] = None
    return list(lines), list(lost)


def _animated_fields(edit: Assignment) -> list[str]:
    """The edited fields that clips change; an instance's or camera's place is its whole transform."""
    fields = {"transform" if isinstance(edit.item, Placed) and name in PLACES else name for name in edit.after}
    return sorted(fields & {*PLACES, "visible"})


def _named_expression(scene: Scene, item: Any) -> str | None:
    """The expression for an object by its name, which stays right in the file; "" if it shares its name or has none,
    None if it isn't in the scene."""
    for kind in ("instances", "cameras", "lights"):
        items = getattr(scene, kind)
        if item in items:
            is_unique = item.name and [other.name for other in items].count(item.name) == 1
            return f"scene.{kind}[{item.name!r}]" if is_unique else ""
    return None


def script_text(session: Session, scene_file: str, edits: Sequence[str] = ()) -> str:
    """A script that renders the picture from the scene in a file beside it. edits: lines after the scene is posed."""
    pictures = session.pictures
    will_change = _will_change(session)
    pose = {**session.camera.pose(), "ev100": session.camera.ev100}
    player = session.player
    shown = "realtime picture of the mode split" if pictures.mode == "split" else f"{pictures.mode} picture"
    lines = [
        f'"""Renders {scene_file} as the viewer of solari_vk showed it: the {shown}."""',
        "",
        "from pathlib import Path",
        "",
        "import solari_vk as sv",
        "",
        "here = Path(__file__).resolve()",
        f"scene = sv.load(here.with_name({scene_file!r}))",
    ]
    if player.posed and player.clip:
        lines.append(f"scene.animate({player.seconds!r}, {player.number})")
    lines += [*edits, f"camera = sv.Camera.from_pose({pose!r})", "with sv.Device() as device:"]
    lines += (
        _reference_lines(session, will_change)
        if pictures.mode == "reference"
        else _realtime_lines(session, will_change)
    )
    return "\n".join([*lines, '    frame.save(here.with_suffix(".png"))', ""])


def _will_change(session: Session) -> bool:
    """Whether the picture isn't finished: then the script renders it as it will be."""
    refinement = session.refinement
    return not session.pictures.ready or (refinement.enabled and not refinement.finished)


def _size_and_seed(session: Session, will_change: bool) -> str:
    width, height = session.pictures.size
    if will_change:
        width, height = session.picture_area.width, session.picture_area.height
    return f"({width}, {height}), seed={session.pictures.seed}"


def _reference_lines(session: Session, will_change: bool) -> list[str]:
    pictures = session.pictures
    samples = session.refinement.samples
    if pictures.reference and not will_change:
        samples = pictures.reference.tracer.samples
    return [
        f"    renderer = sv.PathTracer(device, scene, {_size_and_seed(session, will_change)})",
        f"    renderer.tonemap = {pictures.tonemap!r}",
        f"    frame = renderer.render(camera, samples={samples or SAMPLES})",
    ]


def _realtime_lines(session: Session, will_change: bool) -> list[str]:
    pictures = session.pictures
    values = {name: getattr(session.settings, name) for name in DEFAULTS}
    values["upscale"] = pictures.upscale
    if will_change:
        del values["upscale"]  # it follows the size, which is the whole one then
    settings = [f"{name}={value!r}" for name, value in values.items() if value != DEFAULTS[name]]
    frames = FRAMES if will_change else session.refinement.frames
    return [
        f"    settings = sv.Settings({', '.join(settings)})",
        f"    renderer = sv.Renderer(device, scene, {_size_and_seed(session, will_change)}, settings=settings)",
        f"    renderer.view, renderer.tonemap = {pictures.debug_view!r}, {pictures.tonemap!r}",
        f"    for _ in range({frames}):",
        "        frame = renderer.render(camera)",
    ]
