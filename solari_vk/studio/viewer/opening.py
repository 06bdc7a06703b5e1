"""Files that the user opens, adds or surrounds the scene by; and those that were opened before."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from solari_vk.base import disk_cache
from solari_vk.scene.collection import Items
from solari_vk.scene.files.formats import readable_suffixes
from solari_vk.scene.lights.environment import Environment, EnvironmentLight
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.load import load
from solari_vk.scene.load import open as open_scene
from solari_vk.scene.presenting.studio_lights import heading, studio_environment
from solari_vk.studio.viewer.camera_control import extent_of
from solari_vk.studio.viewer.history import Edit, Presence
from solari_vk.studio.viewer.pictures import meter_exposure
from solari_vk.studio.viewer.session import Session

MAPS = (".hdr", ".exr", ".png", ".jpg", ".jpeg")
RECENT = "recent-files"  # in the disk cache
MOST_RECENT = 12
MOST_LISTED = 200  # files of a folder


def is_map(path: Path) -> bool:
    """Whether a file is taken as a picture of all directions."""
    return path.suffix.lower() in MAPS


def open_file(session: Session, path: Path) -> None:
    """Show a file in place of the scene, framed and lit as the command line shows it. Forgets the edits.

    Raises SolariError for a file that can't be read; everything then stays as it was.
    """
    # Built-in scenes have names such as builtin:cornell_box, which are no paths.
    source = path if str(path).startswith("builtin:") else Path(os.path.abspath(path))
    loaded = open_scene(str(source))
    picture = session.layout.picture
    camera = dataclasses.replace(loaded.camera_for(picture.width / max(picture.height, 1)))
    session.replace_scene(loaded, source, lambda: open_scene(str(source)))
    session.scene.camera = camera
    meter_exposure(session.device, session.pictures.binder, camera)
    session.camera_control.begin(camera, extent_of(session.scene))
    session.pictures.cut()
    add_recent(source)
    session.say(f"showing {source.name}")


def add_file(session: Session, path: Path) -> None:
    """Add what is in a file to the scene."""
    scene = session.scene
    loaded = load(path)
    holders: tuple[Items[Any], ...] = (scene.instances, scene.lights)
    # The file is in the scene before the edit is recorded: adding assigns names, and an error leaves nothing to undo.
    before = [len(items) for items in holders]
    group = scene.add(loaded, name=path.stem)
    edits: list[Edit] = []
    for items, count in zip(holders, before, strict=True):
        edits += [Presence(items, items[number], number, True) for number in range(count, len(items))]
    session.history.record(f"adding {path.name}", edits)
    session.selected = next(iter(scene.instances[-1:]), None)
    session.say(f"added {len(group.items)} objects of {path.name}")


def surround(session: Session, kind: str) -> None:
    """Surround the scene by "none", "studio", "sky", or a picture of all directions in a file."""
    scene = session.scene
    camera = session.camera
    made: EnvironmentLight | None
    if kind == "none":
        made = None
    elif kind == "studio":
        # 2^EV100 cd/m^2 is about white at the camera's exposure; walls of a studio are a fifth of that.
        made = studio_environment(0.2 * 2.0**camera.ev100)
        made.update(rotation=heading(camera))
    elif kind == "sky":
        made = Sky()
    else:
        made = Environment(kind, name=Path(kind).name)
    before = scene.environment.lights if scene.environment else ()
    session.history.replace(scene.lights, before, made.lights if made else (), f"surroundings: {Path(kind).name}")
    if is_map(Path(kind)):
        session.map_folder = Path(kind).resolve().parent


def maps_in(folder: Path) -> list[str]:
    """The paths of the files of a folder that can surround a scene: .hdr and .exr."""
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in MAPS[:2])
    except OSError:
        return []
    return [str(path) for path in found[:MOST_LISTED]]


def recent_files() -> list[str]:
    """The paths of the files that were opened last and still exist, the latest one first."""
    content = disk_cache.load(RECENT)
    try:
        listed = json.loads(content) if content else []
    except ValueError:
        listed = []
    return [path for path in listed if isinstance(path, str) and os.path.exists(path)]


def add_recent(path: Path) -> None:
    """Put a file first in the list of those that were opened."""
    if path.suffix.lower() in readable_suffixes():
        known = [str(path), *(other for other in recent_files() if other != str(path))]
        disk_cache.store(RECENT, json.dumps(known[:MOST_RECENT]).encode())
