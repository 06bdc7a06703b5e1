"""A folder of pictures that can be left and taken up again: a ledger beside them says what is finished."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.cluster.bench import OneDevice, pack
from solari_vk.cluster.crew import Crew
from solari_vk.cluster.shots import Shot
from solari_vk.errors import SolariError
from solari_vk.output.picture import whole_file
from solari_vk.scene.model import Camera, Scene


class Ledger:
    """The shots whose files are in the ledger's folder, one JSON line each, with the SHA-256 of each file.

    made_of: what all shots of the folder have in common, by name. Raises SolariError for a ledger of other pictures,
    and for one that can't be read.
    """

    def __init__(self, path: Path, made_of: dict[str, Any]) -> None:
        self._path = path
        self._files: dict[str, dict[str, str]] = {}  # by the keys of the shots
        head = json.loads(_as_json({"made_of": made_of}))
        lines = self._read_lines()
        if not lines:
            self._write(json.dumps(head, sort_keys=True) + "\n")
        else:
            there = lines[0].get("made_of", {})
            if other := [name for name, value in head["made_of"].items() if there.get(name) != value]:
                raise SolariError(
                    f"{path.parent}: its pictures were made with another {', another '.join(other)}: give another "
                    f"folder, or remove {path}"
                )
            self._files = {line["shot"]: line["files"] for line in lines[1:]}

    def _read_lines(self) -> list[dict[str, Any]]:
        try:
            lines = self._path.read_text(encoding="utf-8").split("\n")
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            raise SolariError(f"{self._path}: can't be read: {error}") from None
        whole = lines[:-1]
        if lines[-1]:  # the last line was cut off
            self._write("".join(f"{line}\n" for line in whole), "w")
        try:
            return [json.loads(line) for line in whole]
        except ValueError as error:
            raise SolariError(f"{self._path}: is damaged: {error}: remove it, and all pictures are made anew") from None

    def _write(self, text: str, mode: str = "a") -> None:
        try:
            with open(self._path, mode, encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise SolariError(f"{self._path}: can't be written: {error.strerror}") from None

    def has(self, shot: Shot) -> bool:
        """Whether all files of a shot are in the folder with the content that they had."""
        files = self._files.get(_key(shot))
        return files is not None and all(_sha256(self._path.parent / name) == files[name] for name in files)

    def note(self, shot: Shot, files: dict[str, str]) -> None:
        """Record that a shot's files are in the folder. files: the SHA-256 of each by its name."""
        self._files[_key(shot)] = files
        self._write(json.dumps({"shot": _key(shot), "files": files}) + "\n")


def render_shots(
    crew: Crew | OneDevice, scene: Scene, shots: Sequence[Shot], path: Path, *,
    progress: Callable[[int], object] | None = None,
) -> int:  # fmt: skip
    """Render the shots that aren't finished into the folder of their ledger, `path`; returns the number of pictures
    that are there at the end.

    progress: is called with the number of finished pictures, about once a second; when it returns True, rendering ends.
    All shots have one style. Raises SolariError for a folder with other pictures, a file that can't be written, and
    when workers fail; pictures that are finished stay, and the next call goes on after them.
    """
    style = shots[0].style
    ledger = Ledger(path, {"scene": pack(scene)[0], "device or code": crew.identity, "style": style})
    missing = [shot for shot in shots if not ledger.has(shot)]
    count = sum(len(shot.views) for shot in shots) - sum(len(shot.views) for shot in missing)
    if progress is not None and progress(count):
        return count
    with closing(crew.map(scene, missing)) as results:
        for done in results:
            if done is not None:
                shot, files = done
                for name, file in files.items():
                    if file.data is not None:
                        with whole_file(path.parent / name) as temporary:
                            temporary.write_bytes(file.data)
                ledger.note(shot, {name: file.sha256 for name, file in files.items()})
                count += len(shot.views)
            if progress is not None and progress(count):
                break
    return count


def _key(shot: Shot) -> str:
    return hashlib.sha256(_as_json(dataclasses.replace(shot, folder=None)).encode()).hexdigest()[:16]


def _as_json(value: Any) -> str:
    return json.dumps(value, default=_plain, sort_keys=True)


def _plain(value: Any) -> Any:
    if isinstance(value, Camera):
        return {**value.pose(), "jitter": value.jitter.tolist()}
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    assert isinstance(value, np.generic)
    return value.item()


def _sha256(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
