"""Saves what the viewer shows: the scene as glTF, and a script in Python that renders the picture from it."""

from __future__ import annotations

import warnings
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.files import make_folder, write_whole
from solari_vk.settings import DEFAULTS
from solari_vk.viewer.session import Session


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
    write_whole(script, script_text(session, path.name))
    return script, [str(warning.message) for warning in noted]


def script_text(session: Session, scene_file: str) -> str:
    """A script that renders the picture from the scene in a file beside it."""
    pictures, camera = session.pictures, session.camera
    width, height = pictures.size if pictures.ready else session.window.pixels
    pose = {**camera.pose(), "ev100": camera.ev100}
    player = session.player
    lines = [
        f'"""Renders {scene_file} as the viewer of solari_vk showed it."""',
        "",
        "from pathlib import Path",
        "",
        "import solari_vk as sv",
        "",
        "here = Path(__file__).resolve()",
        f"scene = sv.load(here.with_name({scene_file!r}))",
        *([f"scene.animate({player.seconds!r}, {player.number})"] if player.posed else []),
        f"camera = sv.Camera.from_pose({pose!r})",
        "with sv.Device() as device:",
    ]
    options = f"({width}, {height}), seed={pictures.seed}"
    if pictures.mode == "reference":
        samples = max(pictures.reference.tracer.samples if pictures.reference else 0, 1)
        lines += [
            f"    renderer = sv.PathTracer(device, scene, {options})",
            f"    renderer.tonemap = {pictures.tonemap!r}",
            f"    frame = renderer.render(camera, samples={samples})",
        ]
    else:
        changed = {name: getattr(session.settings, name) for name in DEFAULTS}
        settings = [f"{name}={value!r}" for name, value in changed.items() if value != DEFAULTS[name]]
        frames = pictures.realtime.frame_count if pictures.realtime is not None else 32
        lines += [
            f"    settings = sv.Settings({', '.join(settings)})",
            f"    renderer = sv.Renderer(device, scene, {options}, settings=settings)",
            f"    renderer.view, renderer.tonemap = {pictures.view!r}, {pictures.tonemap!r}",
            f"    for _ in range({max(frames, 1)}):",
            "        frame = renderer.render(camera)",
        ]
    return "\n".join([*lines, '    frame.save(here.with_suffix(".png"))', ""])
