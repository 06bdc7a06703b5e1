"""Compiled shaders on disk: those shipped with the package, and those compiled on this machine.

Both are found by a hash of all the text that a shader is made from, so a stale module can't be used.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from solari_vk import disk_cache
from solari_vk.gpu.shaders import headers

_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]+["<]([^">\n]+)[">]', re.MULTILINE)
_INDEX = "shipped.json"


def closure(roots: Sequence[Path], path: str, source: bytes | None = None) -> dict[str, bytes]:
    """The files and generated headers a shader may include, itself first, as {path: text}.

    A path is looked up in the roots in their order; `source` stands for the text of the first. Includes in inactive
    #if branches count too. Raises CompilationError for a generated header that no module makes.
    """
    found: dict[str, bytes] = {}
    waiting = [path]
    if source is not None:
        found[path] = source
        waiting = list(_includes(roots, path, source, found))
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        file = _find(roots, name)
        try:
            found[name] = file.read_bytes() if file else b"\0missing"
        except OSError:
            found[name] = b"\0missing"
        waiting += _includes(roots, name, found[name], found)
    return found


def _find(roots: Sequence[Path], name: str) -> Path | None:
    return next((file for root in roots if (file := root / name).is_file()), None)


def _includes(roots: Sequence[Path], name: str, text: bytes, found: dict[str, bytes]) -> Iterator[str]:
    """The paths of the files that `text` includes; the generated headers among its includes are put into `found`."""
    for match in _INCLUDE.finditer(text):
        requested = match[1].decode(errors="replace")
        if headers.is_generated(requested):
            if requested not in found:
                line = text.count(b"\n", 0, match.start(1)) + 1
                found[requested] = headers.header_text(requested, f"{_find(roots, name) or name}:{line}")
                yield from _includes(roots, requested, found[requested], found)
            continue
        beside = os.path.normpath(os.path.join(os.path.dirname(name), requested)).replace(os.sep, "/")
        yield beside if _find(roots, beside) else os.path.normpath(requested).replace(os.sep, "/")


def source_key(roots: Sequence[Path], path: str, header: str, options: str) -> str:
    """A hash of everything, except the compiler, that a shader's SPIR-V depends on."""
    digest = hashlib.sha256(f"{path}\0{options}\0{header}\0".encode())
    for name, text in sorted(closure(roots, path).items()):
        digest.update(f"{name}\0{len(text)}\0".encode())
        digest.update(text)
    return digest.hexdigest()


# ---- shipped ----------------------------------------------------------------------------------------


def ship(out: Path, modules: Mapping[str, tuple[str, bytes]]) -> None:
    """Write modules, given as {path below `out`: (source key, SPIR-V)}, and their index."""
    index = {}
    for path, (key, spirv) in modules.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(spirv)
        index[key] = {"file": path, "sha256": hashlib.sha256(spirv).hexdigest()}
    out.mkdir(parents=True, exist_ok=True)
    (out / _INDEX).write_text(json.dumps(index, indent=1, sort_keys=True) + "\n", encoding="utf-8")


@lru_cache(maxsize=8)
def _index(file: Path, modified_ns: int) -> dict[str, dict[str, str]]:
    content: dict[str, dict[str, str]] = json.loads(file.read_text(encoding="utf-8"))
    return content


def shipped(root: Path, key: str) -> bytes | None:
    """The module shipped for these sources, or None; a damaged one gives a warning and None."""
    index = root / _INDEX
    try:
        entry = _index(index, index.stat().st_mtime_ns).get(key)
        if entry is None:
            return None
        spirv = (root / entry["file"]).read_bytes()
        if hashlib.sha256(spirv).hexdigest() == entry["sha256"]:
            return spirv
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        warnings.warn(f"the compiled shaders listed in {index} can't be read ({error})", stacklevel=3)
        return None
    warnings.warn(f"the compiled shader {root / entry['file']} is damaged; compiling it instead", stacklevel=3)
    return None


# ---- cache ------------------------------------------------------------------------------------------


def cached(key: str, compiler: str, make: Callable[[], bytes]) -> bytes:
    """The module with this source key from the cache on disk; one that isn't there is made and stored."""
    name = hashlib.sha256(f"{key} {compiler}".encode()).hexdigest() + ".spv"
    spirv = disk_cache.load(name)
    if spirv is None:
        spirv = make()
        disk_cache.store(name, spirv)
    return spirv
