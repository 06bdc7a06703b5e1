"""Compiled shaders on disk: those shipped with the package, and those compiled on this machine.

Both are found by a hash of all the text that a shader is made from, so a stale module can't be used.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from solari_vk.base.errors import SolariError, warn
from solari_vk.base.files import read_regular
from solari_vk.gpu.shaders import headers

_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]([^">\n]+)[">]', re.MULTILINE)
_INDEX = "shipped.json"
# Slang imports modules by their names: `import a.b;` is the file a/b.slang.
_IMPORT = re.compile(rb'\b(?:import|__include)\s+("[^"\n]+"|[\w.]+)(?=\s*;)')
_TEXT_OR_COMMENT = re.compile(rb'"[^"\n]*"|//[^\n]*|/\*.*?\*/', re.DOTALL)


def _without_comments(source: bytes) -> bytes:
    """Lines keep their numbers."""

    def blank(found: re.Match[bytes]) -> bytes:
        return found[0] if found[0].startswith(b'"') else b" " + b"\n" * found[0].count(b"\n")

    return _TEXT_OR_COMMENT.sub(blank, source)


class Sources:
    """The GLSL files below some roots and the generated headers, as they are when each is first needed.

    A path is looked up in the roots in their order.
    """

    MISSING = b"\0missing"  # the text of a file that is in none of them

    def __init__(self, roots: Sequence[Path]) -> None:
        self.roots = list(roots)
        self._files: dict[str, Path | None] = {}
        self._texts: dict[str, bytes] = {}
        self._digests: dict[str, bytes] = {}
        self._includes: dict[str, list[str]] = {}

    def find(self, path: str) -> Path | None:
        """The file of a path."""
        if path not in self._files:
            # The first root wins, so that overlays replace single files of the package.
            files = (root / path for root in self.roots)
            self._files[path] = next((file for file in files if os.path.isfile(file)), None)
        return self._files[path]

    def closure(self, path: str, source: bytes | None = None, header: str = "") -> dict[str, bytes]:
        """The files and generated headers a shader may include, itself first, as {path: text}.

        `source` stands for the shader's text, `header` comes before it. Includes in inactive #if branches count too.
        Raises CompilationError for a generated header that no module makes.
        """
        if source is not None:
            self._texts[path] = source
        found: dict[str, bytes] = {}
        waiting = [*self._included_by(path, header.encode()), path]
        while waiting:
            name = waiting.pop()
            # A file may be included by several; its text and includes are read once.
            if name not in found:
                found[name] = self._text(name)
                if name not in self._includes:
                    self._includes[name] = list(self._included_by(name, found[name]))
                waiting += self._includes[name]
        return found

    def _text(self, name: str) -> bytes:
        if name not in self._texts:
            file = self.find(name)
            try:
                self._texts[name] = read_regular(file, name) if file else self.MISSING
            except SolariError:
                self._texts[name] = self.MISSING
        return self._texts[name]

    def _included_by(self, name: str, text: bytes) -> Iterator[str]:
        text = _without_comments(text)
        for match in _IMPORT.finditer(text) if name.endswith(".slang") else ():
            module = match[1].decode(errors="replace")
            file = module.strip('"') if module.startswith('"') else module.replace(".", "/")
            beside = os.path.join(os.path.dirname(name), file).replace(os.sep, "/")
            places = [f"{place.removesuffix('.slang')}.slang" for place in (beside, file)]
            # Slang finds a_b in a-b.slang too.
            places += [place.replace("_", "-") for place in places]
            yield next((place for place in places if self.find(place)), places[0])
        for match in _INCLUDE.finditer(text):
            requested = match[1].decode(errors="replace")
            if headers.is_generated(requested):
                if requested not in self._texts:
                    line = text.count(b"\n", 0, match.start(1)) + 1
                    where = f"{self.find(name) or name}:{line}"
                    self._texts[requested] = headers.header_text(requested, where)
                yield requested
            else:
                beside = os.path.normpath(os.path.join(os.path.dirname(name), requested)).replace(os.sep, "/")
                yield beside if self.find(beside) else os.path.normpath(requested).replace(os.sep, "/")

    def key(self, path: str, header: str, options: str) -> str:
        """A hash of everything, except the compiler, that a shader's SPIR-V depends on."""
        digest = hashlib.sha256(f"{path}\0{options}\0{header}\0".encode())
        for name, text in sorted(self.closure(path, header=header).items()):
            if name not in self._digests:
                self._digests[name] = hashlib.sha256(text).digest()
            digest.update(f"{name}\0".encode() + self._digests[name])
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
        warn(f"the compiled shaders listed in {index} can't be read ({error})")
        return None
    warn(f"the compiled shader {root / entry['file']} is damaged; compiling it instead")
    return None


# ---- cache ------------------------------------------------------------------------------------------


def cache_entry(key: str, compiler: str) -> str:
    """The name in the cache on disk of the module with this source key, compiled by this compiler."""
    return hashlib.sha256(f"{key} {compiler}".encode()).hexdigest() + ".spv"
