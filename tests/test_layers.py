"""The architecture, read from the sources: who may import whom, who may name what, how long a file may be."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

import solari_vk
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

# The rooms of the package, each with the rooms that it may import; "" is solari_vk/__init__.py.
HOST = {"base", "gpu"}
DRAWN = {*HOST, "scene", "bound", "passes", "settings", "output"}
CORE = {*DRAWN, "renderers", "batch", "cli"}
WINGS = {"data", "robots", "studio", "lab"}
MAY_IMPORT = {
    "base": set(),
    "gpu": {"base"},
    "scene": {"base"},
    "bound": {*HOST, "scene"},
    "settings": HOST,
    "passes": {*HOST, "settings"},
    "output": {*HOST, "scene"},
    "renderers": DRAWN,
    "batch": {*DRAWN, "renderers"},
    "cli": {"", *CORE},
    "data": {"", *CORE},
    "robots": {"", *CORE},
    "studio": {"", *CORE},
    "lab": {"", *CORE},
    "__main__": {"cli"},
    "": {*CORE, *WINGS},
}
TABLES = {"solari_vk", "solari_vk.cli.commands"}
"""Where the core names what is in the wings: the public names, and the commands."""
COMPUTED_IMPORTS = {
    "solari_vk",
    "solari_vk.cli.options",
    "solari_vk.gpu.shaders.headers",
    "solari_vk.scene.files.formats",
    "solari_vk.scene.files.libraries",
    "solari_vk.lab.cli.bench",
    "solari_vk.lab.conformance.run",
    "solari_vk.lab.conformance.worker",
    "solari_vk.lab.trial.renderers.child",
}
"""The modules whose `import_module` takes a name from elsewhere, so that tools/size.py can't read what they import."""
GLSL_MAY_INCLUDE = {"common": r"common/", "scene": r"common/|scene/", "passes": r"common/|scene/|passes/"}

LONGEST = 400  # lines of a file, but blank ones
LONGEST_TEST = 550

MACHINE_PATH = re.compile(r"(?<![\w.)}\]])/(?:home|root|Users|work|mnt|tmp)/\w")
URL = re.compile(r"\b(?:https?|ssh|git|ftp)://([^\s/\"'>)]+)")
OF_NO_MACHINE = re.compile(r"\bexample\.(?:org|com)$|^127\.0\.0\.1\b|^localhost\b")
PUBLIC_HOSTS = {
    "github.com",
    "git-lfs.github.com",
    "registry.khronos.org",
    "jms55.github.io",
    "doi.org",
    "jcgt.org",
    "arxiv.org",
}


SIZE = runpy.run_path(str(ROOT / "tools" / "size.py"))
IMPORTS, circles = SIZE["import_graph"](PACKAGE), SIZE["circles"]


def room_of(name: str) -> str:
    """The room that a module belongs to."""
    return name.split(".")[1] if "." in name else ""


def module_name(path: Path) -> str:
    """The name by which a file of the package is imported."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def committed_files() -> list[Path]:
    """The files of the project that people write, without asking git, which an sdist doesn't have."""
    tops = [ROOT / name for name in ("solari_vk", "glsl", "tests", "tools", ".ci", "docs")]
    made = re.compile(r"/\.\w+_cache/|__pycache__|/\.git$")
    files = [*ROOT.glob("*.*"), *(path for top in tops for path in top.rglob("*"))]
    return sorted(p for p in files if p.is_file() and p.suffix in TEXT and not made.search(p.as_posix()))


def test_rooms_are_all_that_the_package_holds():
    files = {path.name for path in PACKAGE.iterdir() if path.is_file()}
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir()} - {"__pycache__", "glsl"}
    assert files == {"__init__.py", "__main__.py", "py.typed"}
    assert folders == CORE | WINGS


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_imports_point_one_way(room):
    """Also those inside functions, and those by `import_module`."""
    for name, imported in IMPORTS.items():
        if room_of(name) == room:
            wrong = {room_of(other) for other in imported} - MAY_IMPORT[room] - {room}
            assert not wrong, f"{name}: {room} must not import {sorted(wrong)}"


def test_the_core_names_wings_in_its_tables_only():
    """A module's name in a text could hide an import."""
    wing = re.compile(rf"\"(?:solari_vk\.)?(?:{'|'.join(WINGS)})\.\w+")
    for path in MODULES:
        name = module_name(path)
        if room_of(name) in CORE and name not in TABLES:
            assert not wing.search(path.read_text(encoding="utf-8")), name


def modules_reached(starts: set[str]) -> set[str]:
    """Modules, and all that they import, directly or through others."""
    found: set[str] = set()
    more = starts
    while more:
        found |= more
        more = {other for name in found for other in IMPORTS[name]} - found
    return found


def imports_computed_name(node: ast.AST) -> bool:
    """Whether a call imports a module whose name isn't written in the call."""
    if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith(("import_module", "__import__")):
        return False
    return not all(isinstance(argument, ast.Constant) for argument in node.args)


def test_computed_imports_are_listed():
    found = {
        module_name(path)
        for path in MODULES
        if any(map(imports_computed_name, ast.walk(ast.parse(path.read_text(encoding="utf-8")))))
    }
    assert found == COMPUTED_IMPORTS


def test_formats_of_files_are_imported_by_name():
    """Packers, which read imports, miss what scene/files/formats.py finds in its folder."""
    formats = "solari_vk.scene.files.formats"
    folder = formats.removesuffix("formats")
    registered = {name for name, imported in IMPORTS.items() if formats in imported and name.startswith(folder)}
    assert registered
    assert registered <= modules_reached({"solari_vk.scene.load"})


def test_the_core_uses_no_public_name_of_a_wing():
    """`import solari_vk` imports no wing, but its names import their modules on first use."""
    in_wings = {name for name, module in solari_vk._MODULES.items() if room_of(module) in WINGS}
    assert in_wings
    for path in MODULES:
        name = module_name(path)
        if room_of(name) in CORE:
            used = public_names(ast.parse(path.read_text(encoding="utf-8")))
            assert not used & in_wings, f"{name}: {sorted(used & in_wings)}"


def public_names(tree: ast.Module) -> set[str]:
    """The names of solari_vk that a module uses: `from solari_vk import NAME`, and NAME of its aliases."""
    aliases, used = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            aliases |= {found.asname or "solari_vk" for found in node.names if found.name == "solari_vk"}
        if isinstance(node, ast.ImportFrom) and node.module == "solari_vk":
            used |= {found.name for found in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            used.add(node.attr)
    return used


def test_no_modules_import_each_other():
    assert not circles(IMPORTS)


def test_the_scene_reaches_no_device():
    """Not even through others: scenes are made, loaded and animated on machines without Vulkan."""
    reached = modules_reached({name for name in IMPORTS if room_of(name) == "scene"})
    found = {name for name in reached if room_of(name) in ("bound", "gpu")}
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
TENSORS = ("transforms", "cameras", "views", "views_ball", "vertices", "bounds", "texels", "smaller_level", "materials")
KERNELS = {
    "scene/deform.comp",
    "scene/trees/build.comp",
    "scene/trees/refit.comp",
    *(f"scene/tensors/{name}.comp" for name in TENSORS),
}
"""Run outside of frames, and write by address: gpu/frame/kernel.py."""


def naming(word: str) -> set[Path]:
    """The shaders, but for the suite's, in which this matches."""
    return {path for path in SHADERS if SUITE not in path.parents and re.search(word, path.read_text(encoding="utf-8"))}


def test_only_trace_names_ray_queries():
    """Passes trace by trace.glsl, by queries or by pipelines. ray_query.glsl and ray_pipeline.glsl have the functions
    of the wgpu document, for users and the suite; no pass of the renderer reaches them."""
    queries = {GLSL / "scene" / name for name in ("ray_query.glsl", "ray_query_state.glsl")}
    assert naming(r"rayQuery\w*EXT|GL_EXT_ray_query") == {*queries, TRACE}
    assert naming(r"rayPayload\w*EXT|traceRayEXT|GL_EXT_ray_tracing\b") == {
        path
        for path in TRACE.parent.glob("trace.*")
        if path.suffix != ".spv"  # which building a wheel leaves
    } | {GLSL / "scene/ray_pipeline.glsl"}
    users = [path for path in ENTRY_POINTS if not reached(path).isdisjoint(queries)]
    assert users
    assert all(SUITE in path.parents for path in users)


SHADES_PATHS = {"passes/reference/shade_wave.comp"}
"""These share the code of paths with passes that trace, and don't trace."""


@pytest.mark.parametrize("path", ENTRY_POINTS, ids=lambda path: str(path.relative_to(GLSL)))
def test_passes_reach_trace_only_if_they_trace(path):
    if SUITE not in path.parents and path != LAYOUT:
        name = path.relative_to(GLSL).as_posix()
        used = set(reflect(compile_shader(name), name, writes_by_address=name in KERNELS).main.uses)
        traces = bool(used & {"tlas", "world_structures"})
        assert (TRACE in reached(path)) == (traces or name in SHADES_PATHS)


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
        if path.suffix not in (".md", ".toml") and path.name != "LICENSE"  # tables of data are as long as they are
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
