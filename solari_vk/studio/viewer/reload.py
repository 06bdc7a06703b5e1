"""Watches the shaders and the files that the scene was loaded from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from urllib.parse import unquote

from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_json
from solari_vk.gpu.shaders import shaderc
from solari_vk.gpu.shaders.compiler import glsl_root
from solari_vk.scene.model import COLLECTIONS, Scene

INTERVAL = 0.5  # seconds between two checks
SHADERS = {".glsl", ".slang", ".slangh", ".spv", *("." + stage for stage in shaderc.STAGES)}

Stamps = dict[Path, tuple[int, int]]


class Sources:
    """The shaders, and a glTF file with the files that it names. load: loads the glTF file's scene again."""

    def __init__(self, scene: Scene, file: Path | None, load: Callable[[], Scene] | None) -> None:
        self.scene = scene
        self.load = load
        self._file = file
        self._roots = [glsl_root()]
        self._shaders = self._shader_stamps()
        self._files = self._file_stamps()
        self._next_look = time.monotonic() + INTERVAL

    def changed(self) -> tuple[bool, bool]:
        """Whether shaders changed since the last call, and whether the scene's files did."""
        # Hundreds of `stat` calls, too many for each frame.
        if time.monotonic() < self._next_look:
            return False, False
        self._next_look = time.monotonic() + INTERVAL
        before = self._shaders, self._files
        self._shaders, self._files = self._shader_stamps(), self._file_stamps()
        return self._shaders != before[0], self._files != before[1]

    def watch(self, folders: Iterable[str]) -> None:
        """Watch the shaders of further folders."""
        self._roots += map(Path, folders)
        self._shaders = self._shader_stamps()

    def load_again(self) -> bool:
        """Replace everything in the scene by what the file holds now. Returns False for a scene without a file.

        Raises SolariError for a broken file; the scene then stays as it was.
        """
        if self.load is None:
            return False
        self._replace_content(self.load())
        return True

    def replace(self, loaded: Scene, file: Path, load: Callable[[], Scene]) -> None:
        """Replace everything in the scene by what a loaded scene holds, and watch its file from now on."""
        self._file = file
        self.load = load
        self._replace_content(loaded)
        self.scene.name = loaded.name
        self._files = self._file_stamps()

    def mark_written(self, path: Path) -> None:
        """Don't take the scene's file for changed because the viewer wrote it."""
        if self._file is not None and path.resolve() == self._file.resolve():
            self._files = self._file_stamps()

    def _replace_content(self, loaded: Scene) -> None:
        """Move everything from a loaded scene into this one, which the renderers and the user hold."""
        # An object belongs to one scene only, so it leaves the other one first.
        for name in COLLECTIONS:
            ours, theirs = getattr(self.scene, name), getattr(loaded, name)
            items = list(theirs)
            ours.clear()
            theirs.clear()
            for item in items:
                ours.add(item)
        for name in ("_groups", "_paths", "_variant_sets"):
            setattr(self.scene, name, getattr(loaded, name))
        self.scene.warnings = loaded.warnings
        self.scene.variants = loaded.variants
        self.scene.backdrop = loaded.backdrop

    def _shader_stamps(self) -> Stamps:
        return _stamps(path for root in self._roots for path in root.rglob("*") if path.suffix in SHADERS)

    def _file_stamps(self) -> Stamps:
        return {} if self._file is None or self.load is None else _stamps([self._file, *_named_by(self._file)])


def _stamps(paths: Iterable[Path]) -> Stamps:
    # Time and size: some file systems count time in seconds, in which a file may change twice.
    found = {}
    for path in paths:
        try:
            status = path.stat()
        except OSError:  # the file is missing, or is just being replaced
            continue
        found[path] = status.st_mtime_ns, status.st_size
    return found


def _named_by(file: Path) -> list[Path]:
    """The files that a .gltf names; an empty list for any other file, and while the file can't be read."""
    # The file may be half written just now: the next look finds it whole.
    try:
        document = read_json(file, str(file)) if file.suffix.lower() == ".gltf" else {}
        uris = [item["uri"] for kind in ("buffers", "images") for item in document.get(kind, []) if "uri" in item]
        return [file.parent / unquote(uri) for uri in uris if not uri.startswith("data:")]
    except (SolariError, ValueError, TypeError, AttributeError):
        return []
