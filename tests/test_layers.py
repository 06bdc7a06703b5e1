"""The architecture, read from the sources: who may import whom, who may name what, how long a file may be."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from solari_vk.gpu.shaders import shaderc
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.headers import header_text, is_generated
from solari_vk.gpu.shaders.spirv import reflect

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, GLSL = ROOT / "solari_vk", ROOT / "glsl"
STAGES = {"." + stage for stage in shaderc.STAGES}
TEXT = {".py", ".glsl", *STAGES, ".toml", ".md", ".sh", ""}
SHADERS = sorted(path for path in GLSL.rglob("*") if path.suffix in TEXT and path.is_file())
MODULES = sorted(PACKAGE.rglob("*.py"))

# The parts of the package, each with the parts it may import. The parts of gpu/ are its folders; "" is the package.
# `bound` and `passes` meet in GLSL only.
GPU = {"gpu.device", "gpu.shaders", "gpu.frame", "gpu.acceleration"}
WINGS = {"scene", "bound"}
LIBRARY = {
    "budget", "color", "disk_cache", "errors", "files", "folder_lock", "settings", "output", "passes", "rt", "frame",
    "first_hits", "rendered", "picture_renderer", "tracer", "reference", "renderer", "frame_means", "bands", "batch",
    "batch_options", "batch_frames", "batch_results", "view_renderers", "annotate", "randomize", "sensors",
    "motion_blur", "host_array", "sample_control", "frame_time",
    *WINGS, *GPU,
}  # fmt: skip
RENDERING = {
    "errors", "passes", "frame", "first_hits", "rendered", "picture_renderer", "output", "gpu.device", "gpu.frame",
    *WINGS,
}  # fmt: skip
MAY_IMPORT = {
    "color": set(),
    "errors": {"other_words"},
    "host_array": set(),
    "other_words": set(),
    "settings": {"errors", "gpu.shaders"},
    "output": {"color", "errors", "files", "gpu.shaders", "scene"},
    "budget": {"errors"},
    "files": {"budget", "errors"},
    "folder_lock": {"errors", "files"},
    "disk_cache": {"errors", "files"},
    "gpu.device": {"disk_cache", "errors"},
    "gpu.shaders": {"disk_cache", "errors"},
    "gpu.frame": {"errors", "gpu.device", "gpu.shaders"},
    "gpu.acceleration": {"errors", "host_array", "gpu.device"},
    "scene": {"budget", "color", "errors", "files", "host_array"},
    "bound": {"color", "errors", "scene", *GPU},
    "passes": {"errors", "settings", "gpu.device", "gpu.shaders", "gpu.frame"},
    "rt": {"errors", *GPU},
    "frame": {"errors", *GPU, *WINGS},
    "tracer": {"errors", "frame", "passes", *GPU, *WINGS},
    "annotate": {"errors", "files", "output", "tracer", "scene"},
    "sensors": {"annotate", "errors", "files", "output", "scene", "tracer"},
    "randomize": {"errors", "files", "scene"},
    "first_hits": {"passes", "gpu.device", "gpu.frame", *WINGS},
    "rendered": {"errors", "passes", "first_hits", "output", "gpu.device", *WINGS},
    "picture_renderer": RENDERING - {"picture_renderer"},
    "motion_blur": RENDERING,
    "sample_control": {"errors", "output", "passes", "gpu.frame"},
    "reference": {"motion_blur", "sample_control", *RENDERING},
    "light_meter": {"color", "reference", "gpu.acceleration", *RENDERING},
    "frame_time": {"errors", "passes", "settings", "gpu.device", "gpu.frame"},
    "renderer": {"frame_time", "motion_blur", "settings", *RENDERING},
    "bands": {"reference", *RENDERING},
    "view_renderers": {"reference", "renderer", "gpu.shaders", *RENDERING},
    "batch_options": {"host_array", "renderer", "gpu.acceleration", *RENDERING},
    "batch_frames": {"host_array", *RENDERING},
    "batch_results": {"batch_frames", "batch_options", "view_renderers", *RENDERING},
    "batch": {
        "batch_options", "batch_frames", "batch_results", "reference", "view_renderers", "gpu.acceleration",
        "gpu.shaders", *RENDERING,
    },
    "frame_means": {"output", "renderer"},
    "viewer": LIBRARY - {"rt", "tracer", "gpu.acceleration"},
    "cluster": LIBRARY,
    "browser": {"errors", "scene", "bound", "settings", "output", "passes", "reference", "viewer", "gpu.device"},
    "notebook": {"errors", "scene", "renderer", "viewer", "browser"},
    "conformance": {"", "measure", *LIBRARY},
    "measure": {"", "cluster", *LIBRARY},
    "cli": {"", "viewer", "browser", "cluster", "conformance", "measure", "other_words", *LIBRARY},
    "__main__": {"cli"},
    "": {"viewer", "cluster", "notebook", "light_meter", *LIBRARY},
}
GLSL_MAY_INCLUDE = {"common": r"common/", "scene": r"common/|scene/", "passes": r"common/|scene/|passes/"}

# Files should have about 250 lines; blank lines don't count, and a tenth more is accepted.
LONGEST, LONGEST_TEST = 275, 500

MACHINE_PATH = re.compile(r"(?<![\w.)}\]])/(?:home|root|Users|work|mnt|tmp)/\w")
URL = re.compile(r"\b(?:https?|ssh|git|ftp)://([^\s/\"'>)]+)")
OF_NO_MACHINE = re.compile(r"\bexample\.(?:org|com)$|^127\.0\.0\.1\b|^localhost\b")
PUBLIC_HOSTS = {"github.com", "registry.khronos.org", "jms55.github.io", "doi.org", "jcgt.org", "arxiv.org"}


SIZE = runpy.run_path(str(ROOT / "tools" / "size.py"))
IMPORTS, circles = SIZE["import_graph"](PACKAGE), SIZE["circles"]


def part_of(name: str) -> str:
    """The part that a module belongs to, as MAY_IMPORT calls it."""
    parts = name.split(".")[1:]
    return ".".join(parts[:2] if parts[:1] == ["gpu"] else parts[:1])


def committed_files() -> list[Path]:
    """The files of the project that people write, without asking git, which an sdist doesn't have."""
    tops = [ROOT / name for name in ("solari_vk", "glsl", "tests", "tools", ".ci", "docs")]
    made = re.compile(r"/\.\w+_cache/|__pycache__|/\.git$")
    files = [*ROOT.glob("*.*"), *(path for top in tops for path in top.rglob("*"))]
    return sorted(p for p in files if p.is_file() and p.suffix in TEXT and not made.search(p.as_posix()))


def test_imports_point_one_way():
    for name, imported in IMPORTS.items():
        part = part_of(name)
        if part == "gpu":
            assert not imported, "gpu/ itself holds folders only"
            continue
        assert part in MAY_IMPORT, f"{part} is new: it needs a line in MAY_IMPORT"
        wrong = {part_of(other) for other in imported} - MAY_IMPORT[part] - {part}
        assert not wrong, f"{name}: {part} must not import {sorted(wrong)}"


def test_no_modules_import_each_other():
    assert not circles(IMPORTS)


def test_the_scene_reaches_no_device():
    """Not even through others: scenes are made, loaded and animated on machines without Vulkan."""
    reached = {name for name in IMPORTS if part_of(name) == "scene"}
    while more := {other for name in reached for other in IMPORTS[name]} - reached:
        reached |= more
    found = {name for name in reached if part_of(name) == "bound" or part_of(name).startswith("gpu")}
    assert not found, f"solari_vk.scene reaches {sorted(found)}"


@pytest.mark.parametrize(("library", "home"), [("vulkan", "gpu/device/raw.py"), ("argparse", "cli/options.py")])
def test_a_library_has_one_home(library, home):
    """Behind cli/options.py, commands see typed jobs."""
    importing = re.compile(rf"^\s*(?:import|from) {library}\b", re.MULTILINE)
    found = [path for path in MODULES if importing.search(path.read_text(encoding="utf-8"))]
    assert found == [PACKAGE / home]


def included(path: Path) -> list[str]:
    """The paths below the GLSL root that a shader includes itself."""
    return re.findall(r'^\s*#\s*include\s+"([^"]+)"', path.read_text(encoding="utf-8"), re.MULTILINE)


def reached(path: Path) -> set[Path]:
    """A shader and all files that it includes, directly or through others; generated headers include none."""
    found, waiting = set(), [path]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += [GLSL / name for name in included(file) if not is_generated(name)]
    return found


TRACE = GLSL / "scene" / "trace.glsl"
ENTRY_POINTS = [path for path in SHADERS if path.suffix in STAGES]
SUITE = GLSL / "passes" / "conformance"
LAYOUT = GLSL / "passes" / "layout.comp"  # declares what others bind
GIVEN = ("transforms", "cameras", "views", "views_ball", "vertices", "bounds", "texels", "smaller_level", "materials")
KERNELS = {"scene/deform.comp", *(f"scene/given/{name}.comp" for name in GIVEN)}
"""Run outside of frames, and write by address: gpu/frame/kernel.py."""


def naming(word: str) -> set[Path]:
    """The shaders, but for the suite's, in which this matches."""
    return {path for path in SHADERS if SUITE not in path.parents and re.search(word, path.read_text(encoding="utf-8"))}


def test_only_trace_names_ray_queries():
    """Passes trace by trace.glsl, by queries or by pipelines. ray_query.glsl and its debug build have the functions
    of the wgpu document, for users and the suite; no pass of the renderer reaches them."""
    queries = {GLSL / "scene" / name for name in ("ray_query.glsl", "ray_query_debug.glsl")}
    assert naming(r"rayQuery\w*EXT|GL_EXT_ray_query") == {*queries, TRACE}
    assert naming(r"rayPayload\w*EXT|traceRayEXT|GL_EXT_ray_tracing\b") == {
        path for path in TRACE.parent.glob("trace.*") if path.suffix != ".spv"  # which building a wheel leaves
    }
    users = [path for path in ENTRY_POINTS if not reached(path).isdisjoint(queries)]
    assert users
    assert all(SUITE in path.parents for path in users)


@pytest.mark.parametrize("path", ENTRY_POINTS, ids=lambda path: str(path.relative_to(GLSL)))
def test_passes_reach_trace_only_if_they_trace(path):
    if SUITE not in path.parents and path != LAYOUT:
        name = path.relative_to(GLSL).as_posix()
        used = set(reflect(compile_shader(name), name, writes_by_address=name in KERNELS).main.uses)
        assert (TRACE in reached(path)) == bool(used & {"tlas", "world_structures"})


def test_passes_that_trace_share_nothing_in_a_group():
    """Passes that trace are compiled as ray generation shaders too, which have no workgroups."""
    tracing = [path for path in ENTRY_POINTS if TRACE in reached(path)]
    assert tracing
    for file in {file for path in tracing for file in reached(path)}:
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"^\s*shared\b|\bbarrier\(\)|gl_LocalInvocation", text, re.MULTILINE), file


def test_the_scene_reaches_no_pass():
    for path in SHADERS:
        if path.relative_to(GLSL).parts[0] in ("scene", "common"):
            assert not [file for file in reached(path) if (GLSL / "passes") in file.parents], path


def test_shader_lines_have_at_most_120_columns():
    assert SIZE["wide_lines"](ROOT) == []


def test_shaders_keep_the_rules():
    for path in SHADERS:
        text, top = path.read_text(encoding="utf-8"), path.relative_to(GLSL).parts[0]
        assert not re.search(r"#\s*pragma\s+once", text), f"{path}: glslang has no #pragma once: use #ifndef"
        guarded = re.search(r"^#ifndef (\w+)\n#define \1$", text, re.MULTILINE)
        assert guarded or path.suffix != ".glsl", f"{path}: a library is guarded by #ifndef"
        for name in included(path):
            if is_generated(name):
                assert header_text(name, str(path))
                continue
            assert (GLSL / name).is_file(), f"{path}: {name}: includes are paths from the glsl root"
            assert re.match(GLSL_MAY_INCLUDE[top], name), f"{path}: {top} must not include {name}"


def test_files_stay_short():
    counts = {
        path.relative_to(ROOT): sum(1 for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
        for path in committed_files()
        if path.suffix != ".md" and path.name != "LICENSE"
    }
    long = {str(path): n for path, n in counts.items() if n > (LONGEST_TEST if path.parts[0] == "tests" else LONGEST)}
    assert not long, f"a longer file is two ideas: {long}"


def test_no_machine_is_named():
    for path in committed_files():
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            place = f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
            assert path == Path(__file__) or not MACHINE_PATH.search(line), f"a path of one machine: {place}"
            hosts = {host.lower() for host in URL.findall(line) if not OF_NO_MACHINE.search(host)}
            assert hosts <= PUBLIC_HOSTS, f"a host that isn't in PUBLIC_HOSTS: {place}"


def test_the_denoiser_has_one_door():
    """Other shaders know the functions of its api.glsl, and not how its buffers are packed."""
    inside = GLSL / "passes" / "denoise"
    outside = [path for path in SHADERS if inside not in path.parents and path != LAYOUT]
    others = {path: path.read_text(encoding="utf-8") for path in outside}
    used = {name for text in others.values() for name in re.findall(r'"passes/denoise/(\w+)\.glsl"', text)}
    assert used == {"api"}
    assert not [path for path, text in others.items() if re.search(r"\bdenoise_(?!settings)\w+\.at\b", text)]
