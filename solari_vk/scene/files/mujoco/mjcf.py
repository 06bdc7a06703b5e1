"""MJCF files, read by MuJoCo, after a look at what other files they name."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, shortened
from solari_vk.scene.files.mujoco.references import Folder, read_xml

_DIRECTORIES = ("meshdir", "texturedir", "assetdir")
_BYTES_PER_BYTE = 12  # of a mesh or a picture, while it is read
_MOST_FILES = 1000  # of XML
_MOST = 10**9  # that is counted: more is refused anyway
_SMALLEST = 1e-9  # kg and kg m^2: pictures don't depend on them
_LINE = re.compile(r", line \d+")
_BYTES_PER_POINT = 400  # of a height field, with its mesh
_BYTES_PER_COPY = 20_000  # of an element that MuJoCo repeats, with its instance


def compiled(path: Path, folder: str | os.PathLike[str] | None, mujoco: Any) -> Any:
    """The MjModel of an MJCF file. Raises SolariError for what isn't one, and for what MuJoCo says of it."""
    check_files(path, Folder(path, folder))
    return compile_spec(str(path), mujoco, lambda: mujoco.MjSpec.from_file(str(path)))


def compile_spec(who: str, mujoco: Any, make: Any, *, is_rewritten: bool = False) -> Any:
    """The MjModel of an MjSpec that `make` makes. Bodies without a mass get a small one: they aren't simulated.
    is_rewritten: from a text whose lines aren't those of the file."""
    try:
        with _without_warnings(mujoco):
            spec = make()
            spec.compiler.boundmass = max(spec.compiler.boundmass, _SMALLEST)
            spec.compiler.boundinertia = max(spec.compiler.boundinertia, _SMALLEST)
            spec.compiler.balanceinertia = True
            return spec.compile()
    except (ValueError, TypeError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        reason = shortened(_LINE.sub("", reason) if is_rewritten else reason, 200)
        raise SolariError(f"{who}: MuJoCo can't read this: {reason}: mend the file") from None


@contextmanager
def _without_warnings(mujoco: Any) -> Iterator[None]:
    """Without MuJoCo's warnings, which are about what simulations alone depend on, and the log of them that it writes
    into the current folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def check_files(path: Path, folder: Folder) -> None:
    """Raise SolariError unless an MJCF file, and all that it and its parts name, can be read and may be."""
    start = path.resolve()
    roots, named = _read_parts(path, folder)
    charge(_BYTES_PER_COPY * _copies(start, roots, named), str(path), "the copies of its elements")
    subfolders = {
        element.attrib[name]
        for root in roots.values()
        for element in root.iter("compiler")
        for name in _DIRECTORIES
        if name in element.attrib
    }
    for file, root in roots.items():
        # Where MuJoCo looks depends on its version, so that a file counts at each of these places.
        near = (start.parent, file.parent)
        bases = [base / subfolder for base in near for subfolder in ("", *sorted(subfolders))]
        for element in root.iter():
            _check_element(element, bases, folder)


def _read_parts(path: Path, folder: Folder) -> tuple[dict[Path, Element], dict[Element, Path]]:
    """The roots of a file and of all files of XML that are parts of it, by their paths; and these paths by the elements
    that name them."""
    start = path.resolve()
    roots: dict[Path, Element] = {}
    named: dict[Element, Path] = {}
    waiting = [start]
    while waiting:
        file = waiting.pop()
        if file in roots:
            continue
        root = roots[file] = read_xml(file)
        if file == start:
            _check_root(path, root.tag)
        if len(roots) > _MOST_FILES:
            raise SolariError(f"{path}: includes more than {_MOST_FILES} files")
        for element in root.iter():
            if element.tag in ("include", "model") and "file" in element.attrib:
                around = (start.parent, file.parent)
                named[element] = folder.find(element.attrib["file"], around, f"<{element.tag}>")
                waiting.append(named[element])
    return roots, named


def _check_root(path: Path, tag: str) -> None:
    if tag == "mujocoinclude":
        raise SolariError(f"{path}: is a part of a model: load the file that includes it")
    if tag != "mujoco":
        raise SolariError(f"{path}: is no model of MuJoCo, whose XML begins with <mujoco>, but <{shortened(tag, 40)}>")


def _check_element(element: Element, bases: list[Path], folder: Folder) -> None:
    """Check the files of an element, and charge what is read or made of them."""
    if element.tag in ("include", "model"):
        return
    what = f"<{element.tag}> {element.attrib.get('name', '')}".strip()
    for name, value in element.attrib.items():
        if "nan" in value.lower().split():  # of which MuJoCo only warns
            raise SolariError(f"{folder.who}: {what}: {name} is '{shortened(value, 40)}': mend the number")
        if name.startswith("file") and value:
            found = _find(value, bases, folder, what)
            charge(_BYTES_PER_BYTE * found.stat().st_size, folder.who, what)
    if element.tag == "texture":
        width, height = (math.prod(_counts(element, name)) for name in ("width", "height"))
        if element.attrib.get("type", "cube") != "2d":
            height = max(height, 6 * width)  # six faces below each other
        charge(4 * width * height, folder.who, what)
    if element.tag == "hfield":
        rows, columns = (math.prod(_counts(element, name)) for name in ("nrow", "ncol"))
        charge(_BYTES_PER_POINT * rows * columns, folder.who, what)


def _copies(main: Path, roots: dict[Path, Element], named: dict[Element, Path]) -> int:
    """How many elements MuJoCo makes, beyond those of the files, by <replicate>, <composite>, <flexcomp>, <attach>."""
    sizes = [sum(1 for _ in roots[file].iter()) for element, file in named.items() if element.tag == "model"]
    total = 0
    waiting = [(roots[main], 1)]
    included = {main}
    while waiting:
        element, times = waiting.pop()
        total += times - 1
        if element.tag == "include" and named.get(element, main) not in included:  # MuJoCo includes each file once
            included.add(named[element])
            waiting.append((roots[named[element]], times))
        if element.tag == "attach":
            total += times * max(sizes, default=0)
        if element.tag in ("replicate", "composite", "flexcomp"):
            times = min(times * math.prod(_counts(element, "count")), _MOST)
            total += times
        waiting += [(child, times) for child in element]
    return total


def _counts(element: Element, name: str) -> list[int]:
    """The whole numbers of an attribute, at least 1 each; MuJoCo says what is wrong with others."""
    found = []
    for word in element.attrib.get(name, "").split():
        try:
            found.append(min(max(int(float(word)), 1), _MOST))
        except (ValueError, OverflowError):
            continue
    return found


def _find(value: str, bases: list[Path], folder: Folder, what: str) -> Path:
    try:
        return folder.find(value, bases, what)
    except SolariError:
        # With the compiler's `strippath` only the last part of the path counts.
        stripped = Path(value.replace("\\", "/")).name
        if stripped == value:
            raise
        try:
            return folder.find(stripped, bases, what)
        except SolariError:
            pass
        raise
