"""Compiles GLSL to SPIR-V, with pyshaderc's functions, exact error positions, a cache on disk and shipped modules.

`set_include_paths`, `compile_into_spirv`, `compile_file_into_spirv` and `CompilationError` are those of
pyshaderc 1.1. Passes use `compile_shader`: if the sources are unchanged it returns the SPIR-V that was shipped with
the package, else that of the cache on disk, else it runs the compiler. All modules target Vulkan 1.3 (SPIR-V 1.6).

Reflection needs the names, so debug information is always on, and the rest of it (line numbers, source text) is removed
afterwards.

For devices that trace rays by pipelines, compute shaders that trace are compiled as ray generation shaders; the module
`ray_generation` documents it.

Shaders of scenes have two modules: in one the features of scenes (`solari_vk.bound.features`) are specialization
constants, and the other, for scenes without any, has been compiled without their code.

`#include "generated/settings.glsl"` includes what the Python function `solari_vk.settings.glsl_header()` returns; the
module `headers` documents it. These texts take part in the keys of the cache and of shipped modules like any file.
"""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

from solari_vk.base import disk_cache
from solari_vk.base.errors import CompilationError, SolariError, quoted
from solari_vk.base.files import read_regular
from solari_vk.gpu.shaders import dead_code, headers, ray_generation, shader_cache, shaderc
from solari_vk.gpu.shaders.shader_cache import Sources

__all__ = [
    "CompilationError",
    "build_all",
    "compile_file_into_spirv",
    "compile_into_spirv",
    "compile_shader",
    "glsl_root",
    "set_include_paths",
]

Roots = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_include_paths: list[str] = []
overlays: list[Path] = []
"""GLSL roots that are looked up before the package's, for shaders that are used once or twice; tests put bugs there."""


def glsl_root() -> Path:
    """The folder of the package's GLSL: inside the installed package, or beside it in a working copy."""
    installed = Path(__file__).resolve().parents[2] / "glsl"
    return installed if installed.is_dir() else Path(__file__).resolve().parents[3] / "glsl"


def folders(given: Roots | None) -> tuple[str, ...]:
    """One folder or several as a tuple."""
    listed = [given] if isinstance(given, (str, os.PathLike)) else list(given or ())
    return tuple(os.fspath(folder) for folder in listed)


def roots(given: Roots | None = None) -> list[Path]:
    """The folders in which a shader is looked up, in this order: these folders, the overlays, the package's."""
    return list(dict.fromkeys([*map(Path, folders(given)), *overlays, glsl_root()]))


def has_own(given: Roots | None, path: str) -> bool:
    """Whether a shader is in one of these folders, and so the user's and not the package's."""
    return any(os.path.isfile(Path(folder, path)) for folder in folders(given))


def set_include_paths(paths: Sequence[str | os.PathLike[str]]) -> None:
    """Set the folders in which includes of `compile_into_spirv` and `compile_file_into_spirv` are looked up."""
    _include_paths[:] = [os.fspath(path) for path in paths]


def compile_file_into_spirv(
    filepath: str | os.PathLike[str], stage: str, optimization: str = "size", warnings_as_errors: bool = False
) -> bytes:
    """SPIR-V of a GLSL file; arguments and errors as for `compile_into_spirv`."""
    raw = read_regular(Path(filepath), f"the shader {os.fspath(filepath)}")
    return compile_into_spirv(raw, stage, filepath, optimization=optimization, warnings_as_errors=warnings_as_errors)


def compile_into_spirv(
    raw: bytes | str,
    stage: str,
    filepath: str | os.PathLike[str],
    language: str = "glsl",
    optimization: str = "size",
    suppress_warnings: bool = False,
    warnings_as_errors: bool = False,
) -> bytes:
    """SPIR-V of source text, with the names of variables and members.

    `stage` is vert, tesc, tese, geom, frag, comp, or a ray tracing stage such as rgen. Errors show `filepath`, and its
    folder is searched for includes before the include paths. `optimization` is zero, size or performance. Raises
    CompilationError if the source doesn't compile, SolariError for an unknown argument or without a compiler.
    """
    for value, known, what in (
        (stage, shaderc.STAGES, "stage"),
        (language, shaderc.LANGUAGES, "language"),
        (optimization, shaderc.OPTIMIZATIONS, "optimization"),
    ):
        if value not in known:
            raise SolariError(f"unknown {what} {quoted(value)}: take one of {', '.join(known)}")
    source = raw.encode() if isinstance(raw, str) else bytes(raw)
    return _compile_text(
        source,
        stage,
        os.fspath(filepath),
        _include_paths,
        language=language,
        optimization=optimization,
        suppress_warnings=suppress_warnings,
        warnings_as_errors=warnings_as_errors,
    )


def _compile_text(source: bytes, stage: str, name: str, include_paths: Sequence[str], **options: Any) -> bytes:
    included = Sources([Path(name).parent, *map(Path, include_paths)]).closure(Path(name).name, source)
    generated = {path: text for path, text in included.items() if headers.is_generated(path)}
    macros = constant_ids(included.values())
    try:
        spirv = shaderc.compile_source(source, stage, name, include_paths, generated, macros=macros, **options)
    except shaderc.Failure as failure:
        raise CompilationError(_with_source_lines(str(failure), name, source, generated)) from None
    return dead_code.without_texts(spirv)


def constant_ids(texts: Iterable[bytes]) -> dict[str, int]:
    """Numbers for the ids that constants are declared with: `layout(constant_id = size_id) const uint size = 8u;`."""
    named = {found[1].decode() for text in texts for found in _CONSTANT.finditer(text)}
    return {name: number for number, name in enumerate(sorted(named), _FIRST_ID)}


_CONSTANT = re.compile(rb"\bconstant_id\s*=\s*((\w+)_id)\s*\)\s*const\s+\w+\s+\2\b")
_FIRST_ID = 1024  # shaders may number constants of their own from 0; glslang allows ids below 2047
_POSITION = re.compile(r"^(?P<file>.+?):(?P<line>\d+): (?:error|warning): ")


def _with_source_lines(log: str, filepath: str, source: bytes, generated: Mapping[str, bytes]) -> str:
    """shaderc's log, with the source line that a message refers to below the message."""
    shown = []
    for message in log.strip().splitlines():
        shown.append(message)
        found = _POSITION.match(message)
        if found is None:
            continue
        is_shader = Path(found["file"]) == Path(filepath)  # Windows has two signs between folders
        try:
            known = source if is_shader else generated.get(found["file"])
            # A #line directive may name anything.
            text = read_regular(Path(found["file"]), found["file"]) if known is None else known
        except SolariError:
            continue
        lines = text.decode(errors="replace").splitlines()
        # A shader with a header has more lines than its file; line numbers refer to the file.
        if is_shader and os.path.isfile(filepath):
            lines = Path(filepath).read_text("utf-8", "replace").splitlines()
        if int(found["line"]) <= len(lines):
            shown.append("    " + lines[int(found["line"]) - 1].strip())
    return "\n".join(shown) or "the compiler failed without a message"


# ---- the package's own shaders ----------------------------------------------------------------------

# A shader with an empty main is compiled for the reflection of its declarations, so they all stay.
_EMPTY_MAIN = re.compile(r"\bvoid\s+main\s*\(\s*\)\s*\{\s*\}")
# The shaders that shaderc optimizes, which takes up to ten seconds a module: other shaders are as fast without it. The
# path tracer's shader was slower without it by 12 to 23 % on NVIDIA's H100, when one shader traced and shaded.
_OPTIMIZED = ("passes/reference/shade_wave.comp",)
COMMON_FEATURES = {"SCENE_LIGHT_TREE", "SCENE_SMOOTH_NORMALS"}
"""The constants of features that many scenes have: modules for scenes without features have them too."""
_WITHOUT_FEATURES = "WITHOUT_FEATURES"  # what is defined in shaders for scenes without features
_OPTIONS = f"bound, live blocks {shaderc.VULKAN_1_3:x} {shaderc.SPIRV_1_6:x}"
_DIRECTIVE = re.compile(r"^\s*#\s*(version|extension)\b")
_looking_up = threading.Lock()  # a thread that has read a file waits 5 ms for others that run Python


MANY_VIEWS = "#define MANY_VIEWS"  # the header of shaders for many views: glsl/passes/views.glsl
_VIEWS = "passes/views.glsl"
# What draws, looks at or measures one picture, and the layout, which is read as it is for one view.
_FOR_ONE_VIEW = re.compile(
    r"passes/(solari019/|gbuffer/(cull|depth_pyramid|resolve)|reference/(illuminance|raster_aov)|display/(debug|own)_view|"
    r"layout\.comp)"
)


def has_many_views(path: str, sources: Sources | None = None) -> bool:
    """Whether a compute shader has a variant for many views, with the header MANY_VIEWS. One that is for many views
    alone has none."""
    texts = (Sources(roots()) if sources is None else sources).closure(path)
    many = _VIEWS in texts and MANY_VIEWS.encode() not in texts[path] and not _FOR_ONE_VIEW.match(path)
    return path.endswith(".comp") and many


def compile_shader(
    path: str,
    *,
    header: str = "",
    root: Roots | Sources | None = None,
    rays: str = "query",
    features: bool = True,
    lacking: Sequence[str] = (),
) -> bytes:
    """SPIR-V of the shader at `path` below a GLSL root ("passes/x/trace.comp"); the suffix is the stage.

    `header` is text for a variant, put after the #version and #extension lines. The shader and its includes are looked
    up in `root`, one folder or several, and then in the package's folder; or in Sources, which read each file once for
    several shaders. `rays`: how the device traces them. `features`: whether features of scenes
    are specialization constants, otherwise their code is left out. `lacking`: macros that say what the device lacks.
    Raises CompilationError; SolariError if there is no
    such file, if neither a compiler nor a shipped module for exactly these sources is there, or for ray
    queries that no pipeline can replace.
    """
    sources = root if isinstance(root, Sources) else Sources(roots(root))
    spirv = _module(sources, path, header, _defines(sources, path, features))
    if rays == "query" or not ray_generation.uses_ray_queries(spirv):
        return _module(sources, path, header, _defines(sources, path, features, lacking)) if lacking else spirv
    defines = _defines(sources, path, features, lacking, rays)
    return _module_without_queries(sources, path, header, defines, rays)


def _module_without_queries(sources: Sources, path: str, header: str, defines: Sequence[str], rays: str) -> bytes:
    """The module of a compute shader that traces rays by pipelines or by compute. Raises as compile_shader."""
    if not path.endswith(".comp") or ray_generation.TRACE not in sources.closure(path):
        raise SolariError(f"{path}: {ray_generation.OWN_QUERIES}")
    try:
        spirv = _module(sources, path, header, defines)
    except CompilationError as error:
        hint = f"{path}: {ray_generation.HINT}.\n" if rays == "pipeline" else ""
        raise CompilationError(f"{hint}{error}") from None
    if ray_generation.uses_ray_queries(spirv):
        raise SolariError(f"{path}: {ray_generation.OWN_QUERIES}")
    return spirv


def _key(sources: Sources, path: str, header: str, defines: Sequence[str]) -> str:
    return sources.key(path, header, " ".join((_optimization(path), _OPTIONS, *defines)))


def _optimization(path: str) -> str:
    return "performance" if path in _OPTIMIZED and not overlays else "zero"


def _defines(
    sources: Sources, path: str, features: bool, lacking: Sequence[str] = (), rays: str = "query"
) -> list[str]:
    """The macros that are defined in a module, those of them that its text has."""
    macros = [*lacking] if features else [_WITHOUT_FEATURES, *lacking]
    found = [macro for macro in macros if _has_macro(sources, path, macro)]
    return found if rays == "query" else [*found, ray_generation.DEFINES[rays]]


def _has_macro(sources: Sources, path: str, macro: str) -> bool:
    return any(macro.encode() in text for text in sources.closure(path).values())


def _module(sources: Sources, path: str, header: str, defines: Sequence[str]) -> bytes:
    """The module of a shader with these macros."""
    with _looking_up:
        file = sources.find(path)
        if file is None:
            raise SolariError(f"there is no shader {path} in {', '.join(map(str, sources.roots))}")
        source_key = _key(sources, path, header, defines)
        # A shipped module counts only for exactly these sources, whose texts are part of the key.
        for base in sources.roots:
            shipped = shader_cache.shipped(base, source_key)
            if shipped is not None:
                return shipped
        entry = shader_cache.cache_entry(source_key, shaderc.version())
        spirv = disk_cache.load(entry)
    if spirv is None:
        spirv = _compile(sources.roots, file, header, defines, _optimization(path))
        disk_cache.store(entry, spirv)
    return spirv


def _compile(search: Sequence[Path], file: Path, header: str, defines: Sequence[str], optimization: str) -> bytes:
    source, stage = read_regular(file, f"{file}").decode("utf-8", "replace"), file.suffix.lstrip(".")
    # Ray generation shaders have no local size.
    if ray_generation.DEFINE in defines:
        source = ray_generation.without_local_size(source)
        stage = "rgen"
    source = _with_header(source, header, file, "".join(f"#define {name}\n" for name in defines))
    arguments = source.encode(), stage, os.fspath(file), list(map(os.fspath, search))
    spirv = _compile_text(*arguments, optimization=optimization)
    return spirv if _EMPTY_MAIN.search(source) else dead_code.without_dead_code(spirv)


def _with_header(source: str, header: str, file: Path, defines: str) -> str:
    if not header and not defines:
        return source
    lines = source.splitlines(keepends=True)
    # GLSL wants #version first, and #extension before all other code.
    at = max((number for number, line in enumerate(lines, 1) if _DIRECTIVE.match(line)), default=0)
    name = file.as_posix()
    added = f'{defines}#line 1 "{name} (header)"\n{header}\n#line {at + 1} "{name}"\n'
    return "".join((*lines[:at], added, *lines[at:]))


def build_all(root: str | os.PathLike[str], out: str | os.PathLike[str]) -> list[str]:
    """Compile every entry point below a GLSL root, and write the modules and their index to `out` for shipping.

    Returns the paths below `root`. `out` is the root itself, with modules beside their sources, or another folder.
    """
    base = Path(root)
    sources = Sources(roots(base))
    files = sorted(path for path in base.rglob("*") if path.suffix.lstrip(".") in shaderc.STAGES)
    paths = [file.relative_to(base).as_posix() for file in files]
    # shaderc runs in C without Python's lock, so threads compile at the same time.
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        made = list(threads.map(lambda path: list(_shipped_modules(sources, path)), paths))
    shader_cache.ship(Path(out), dict(module for modules in made for module in modules))
    return paths


def _shipped_modules(sources: Sources, path: str) -> Iterator[tuple[str, tuple[str, bytes]]]:
    """The modules of a shader: the file of each, its key and the SPIR-V."""
    headers = ("", MANY_VIEWS) if has_many_views(path, sources) else ("",)
    choices = (True, False) if _has_macro(sources, path, _WITHOUT_FEATURES) else (True,)
    for header, features in product(headers, choices):
        name = path
        if header:
            name += ".views"
        if not features:
            name += ".plain"
        spirv = compile_shader(path, header=header, root=sources, features=features)
        yield f"{name}.spv", (_key(sources, path, header, _defines(sources, path, features)), spirv)
        if ray_generation.uses_ray_queries(spirv) and ray_generation.TRACE in sources.closure(path):
            for rays in ray_generation.DEFINES:
                defines = _defines(sources, path, features, rays=rays)
                spirv = _module_without_queries(sources, path, header, defines, rays)
                yield f"{name}.{rays}.spv", (_key(sources, path, header, defines), spirv)


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[1] != "--build":
        sys.exit("usage: python -m solari_vk.gpu.shaders.compiler --build GLSL_ROOT OUT_DIR")
    print("\n".join(build_all(sys.argv[2], sys.argv[3])))
