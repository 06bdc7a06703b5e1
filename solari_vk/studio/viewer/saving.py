"""Saves what the viewer shows: the scene as glTF, and a script in Python that renders the picture from it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, write_whole
from solari_vk.scene.placement import Placed
from solari_vk.settings import DEFAULTS
from solari_vk.studio.viewer.history import Assignment
from solari_vk.studio.viewer.refinement import FRAMES, SAMPLES
from solari_vk.studio.viewer.session import Session

# Fields that clips change.
PLACES = ("transform", "position", "rotation", "scale", "direction", "horizontal", "center", "half_u", "half_v")


def free_path(session: Session) -> Path:
    """A path in the session's folder where there is no file yet, for `save_scene`."""
    stem, number = Path(session.name or "scene").stem.replace(":", "-") or "scene", 1
    while any(
        (path := session.folder / f"{stem}-{number:03}.glb").with_suffix(end).exists() for end in (".glb", ".py")
    ):
        number += 1
    return path


def files_of(path: Path) -> tuple[Path, ...]:
    """The files that `save_scene` writes for a path. Raises SolariError for another ending than .glb and .gltf."""
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise SolariError(f"{path}: give a name that ends in .glb or .gltf")
    data = [path.with_suffix(".bin")] if path.suffix.lower() == ".gltf" else []
    return (path, path.with_suffix(".py"), *data)


def save_scene(session: Session, path: Path) -> tuple[Path, list[str]]:
    """Write the scene to a .glb or .gltf file, and beside it the script, whose path is returned with what the file
    can't hold. Raises SolariError for another ending, and if a file can't be written."""
    _, script, *_ = files_of(path)
    make_folder(path.parent)
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        session.scene.save(path)
    lines, lost = _animated_edits(session)
    write_whole(script, script_text(session, path.name, lines))
    return script, [*(str(warning.message) for warning in noted), *lost]


def _animated_edits(session: Session) -> tuple[list[str], list[str]]:
    """Assignments that place what was edited as it is now, of what clips place otherwise, and so the file does; and
    which of it has no name that a script could call it by."""
    scene, lines, lost = session.scene, dict[str, None](), dict[str, None]()
    rigs = [clip.rig for clip in scene.animations]
    animated = {item for rig in rigs for item, *_ in (*rig.placed, *rig.skins, *rig.weighted)}
    for edit in session.history:
        if not isinstance(edit, Assignment) or edit.item not in animated:
            continue
        item: Any = edit.item
        fields = {"transform" if isinstance(item, Placed) and name in PLACES else name for name in edit.after}
        for name in sorted(fields & {*PLACES, "visible"}):
            for kind in ("instances", "cameras", "lights"):
                items = getattr(scene, kind)
                if item in items and item.name and [other.name for other in items].count(item.name) == 1:
                    lines[f"scene.{kind}[{item.name!r}].{name} = {np.asarray(getattr(item, name)).tolist()!r}"] = None
                elif item in items:
                    lost[f"the {name} of {item.describe()}, which follows clips and has no name of its own"] = None
    return list(lines), list(lost)


def script_text(session: Session, scene_file: str, edits: Sequence[str] = ()) -> str:
    """A script that renders the picture from the scene in a file beside it. edits: lines after the scene is posed."""
    pictures, camera, refinement = session.pictures, session.camera, session.refinement
    settles = not pictures.ready or (
        refinement.enabled and not refinement.finished
    )  # then this is how the picture will be
    width, height = (session.picture_area.width, session.picture_area.height) if settles else pictures.size
    pose = {**camera.pose(), "ev100": camera.ev100}
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
        *([f"scene.animate({player.seconds!r}, {player.number})"] if player.posed and player.clip else []),
        *edits,
        f"camera = sv.Camera.from_pose({pose!r})",
        "with sv.Device() as device:",
    ]
    options = f"({width}, {height}), seed={pictures.seed}"
    if pictures.mode == "reference":
        samples = pictures.reference.tracer.samples if pictures.reference and not settles else refinement.samples
        lines += [
            f"    renderer = sv.PathTracer(device, scene, {options})",
            f"    renderer.tonemap = {pictures.tonemap!r}",
            f"    frame = renderer.render(camera, samples={samples or SAMPLES})",
        ]
    else:
        changed = {name: getattr(session.settings, name) for name in DEFAULTS}
        changed["upscale"] = pictures.upscale
        settings = [
            f"{name}={value!r}"
            for name, value in changed.items()
            if value != DEFAULTS[name] and not (settles and name == "upscale")
        ]  # it follows the size, which is the whole one then
        frames = FRAMES if settles else refinement.frames
        lines += [
            f"    settings = sv.Settings({', '.join(settings)})",
            f"    renderer = sv.Renderer(device, scene, {options}, settings=settings)",
            f"    renderer.view, renderer.tonemap = {pictures.view!r}, {pictures.tonemap!r}",
            f"    for _ in range({frames}):",
            "        frame = renderer.render(camera)",
        ]
    return "\n".join([*lines, '    frame.save(here.with_suffix(".png"))', ""])
