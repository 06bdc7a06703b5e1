"""The files that robots' files name: where they are, and that they lie in the folder that may be read."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.files import read_regular

# Folders of packages that hold robots, beside the folder `meshes`.
_BESIDE = ("urdf", "mjcf", "xml", "sdf", "robots", "xacro", "launch")
_LEVELS = 6  # above a file, where its package is looked for
_BYTES_PER_BYTE = 16  # of XML, while it is read
_URI = re.compile(r"(package|model|file)://(.*)", re.DOTALL)


class Folder:
    """The folder that a file may read: `given`, else the package that holds the file, else its own folder."""

    def __init__(self, path: Path, given: str | os.PathLike[str] | None = None) -> None:
        self.who = str(path)
        self.near = path.parent.resolve()
        self.is_given = given is not None
        if given is not None:
            self.root = Path(given).resolve()
            if not self.root.is_dir():
                raise SolariError(f"{path}: folder: there is no folder {quoted(str(given))}")
            return
        parents = (self.near, *self.near.parents)[:_LEVELS]
        package = next((parent for parent in parents if (parent / "package.xml").is_file()), None)
        self.root = package or (self.near.parent if self.near.name in _BESIDE else self.near)

    def find(self, reference: str, bases: Iterable[Path], what: str) -> Path:
        """The file that a reference names, looked for from these folders. what: has the reference, for messages.
        Raises SolariError for one that is missing, or outside."""
        text = reference.replace("\\", "/")
        uri = _URI.fullmatch(text)
        if uri is not None and uri[1] != "file":
            return self._in_package(unquote(uri[2]), what)
        places = [Path(unquote(uri[2]))] if uri else [base / text for base in bases]
        outside = None
        for place in places:
            try:
                found = place.resolve()
                if not found.is_file():
                    continue
            except (OSError, ValueError):  # such as a name with a null character
                continue
            if found.is_relative_to(self.root):
                return found
            outside = found
        if outside is not None:
            raise SolariError(
                f"{self.who}: {what}: {quoted(reference)} lies outside of {self.root}, and isn't read: give a folder "
                "that holds both by folder=..."
            )
        raise SolariError(f"{self.who}: {what}: there is no file {quoted(reference)}: check the path")

    def _in_package(self, rest: str, what: str) -> Path:
        """A file of a ROS package, in a folder with its name: one above the file, or in the folder that may be read."""
        name, _, inner = rest.partition("/")
        above = [parent for parent in (self.near, *self.near.parents)[: 2 * _LEVELS] if name and parent.name == name]
        if self.is_given:
            above = [parent for parent in above if parent.is_relative_to(self.root)]
        for package in (*filter(self._is_package, above), self.root / name):
            try:
                found = (package / inner).resolve()
                is_there = found.is_file()
            except (OSError, ValueError):
                continue
            inside = [self.root] if self.is_given else [package, self.root]
            if is_there and any(map(found.is_relative_to, inside)):
                return found
        raise SolariError(
            f"{self.who}: {what}: there is no file {quoted(inner)} in a package {quoted(name)} above the file, a "
            "folder with a package.xml or with the robot in urdf/: give the folder that holds the package by folder=..."
        )

    def _is_package(self, folder: Path) -> bool:
        """Whether a folder above the file is a package: by its package.xml, or by where it has the file."""
        within = self.near.relative_to(folder).parts
        return (folder / "package.xml").is_file() or not within or within[0] in _BESIDE


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file. Raises SolariError for one that is damaged."""
    data = read_regular(path, str(path)).strip(b"\0 \t\r\n")
    charge(0, str(path), "its XML", working=_BYTES_PER_BYTE * len(data))
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SolariError(f"{path}: damaged XML ({error}): export the file again") from None
