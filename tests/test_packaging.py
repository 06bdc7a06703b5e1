"""The sdist, the wheel that is built from it, and shaders that run without a compiler."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from solari_vk.gpu.shaders import shader_cache, shaderc

ROOT = Path(__file__).resolve().parents[1]
STAGES = {"." + stage for stage in shaderc.STAGES}
NO_COMPILER = {"SOLARI_VK_SHADERC": os.devnull, "PATH": "", "SOLARI_VK_CACHE": "off"}
PAGES = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"]
PARTS = ["solari_vk", "glsl", "tests", "tools", "docs", "pyproject.toml", "hatch_build.py", "LICENSE", *PAGES]

# Later Pythons ask for a filter, which Python 3.11.2 of Debian 12 doesn't know yet.
SAFELY = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}


def build(folder: Path, target: str, **environment: str) -> Path:
    """The file that hatchling builds from a source tree."""
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", target],
        cwd=folder, env=os.environ | environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (made,) = (folder / "dist").glob("*.whl" if target == "wheel" else "*.tar.gz")
    return made


def test_addresses_can_be_filled_in():
    """The lines that are comments for whoever publishes the package are right once the signs are removed."""
    text = (ROOT / "pyproject.toml").read_text()
    start = text.index("# [project.urls]")
    lines = text[start:].partition("\n\n")[0]
    filled = text.replace(lines, re.sub("(?m)^# ", "", lines).replace('""', '"https://example.org"'))
    assert len(tomllib.loads(filled)["project"]["urls"]) == 5


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of the sources, with a compiled module that belongs to no shader."""
    copy = tmp_path_factory.mktemp("tree")
    ignored = shutil.ignore_patterns("__pycache__", "*.spv", "shipped.json", ".*_cache", "*.npz")
    for name in PARTS:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=ignored)
        elif (ROOT / name).is_file():
            shutil.copy(ROOT / name, copy / name)
    shutil.copy(ROOT / ".gitignore", copy)
    (copy / "glsl" / "gone.comp.spv").write_bytes(b"from an earlier build")
    return copy


@pytest.fixture(scope="module")
def unpacked_sdist(tree, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sdist")
    with tarfile.open(build(tree, "sdist")) as archive:
        archive.extractall(folder, **SAFELY)
    (unpacked,) = folder.iterdir()
    return unpacked


@pytest.fixture(scope="module")
def wheel(unpacked_sdist):
    """The wheel that a machine without a compiler builds from the sdist."""
    return build(unpacked_sdist, "wheel", **NO_COMPILER)


def entry_points() -> list[str]:
    glsl = ROOT / "glsl"
    return sorted(path.relative_to(glsl).as_posix() for path in glsl.rglob("*") if path.suffix in STAGES)


def compiled_modules() -> set[str]:
    """The files of all modules: each shader's, for shaders that trace another one for ray pipelines, and those for
    scenes without features, which shaders of scenes have."""
    paths = {path: shader_cache.Sources([ROOT / "glsl"]).closure(path) for path in entry_points()}
    traces = {path for path, closure in paths.items() if "scene/trace.glsl" in closure}
    plain = {path for path, closure in paths.items() if "generated/bound/features.glsl" in closure}
    assert 10 < len(traces) < len(plain) < len(paths) / 2
    names = {*paths, *(f"{path}.plain" for path in plain)}
    tracing = {f"{name}.rgen" for name in names if name.removesuffix(".plain") in traces}
    return {f"{name}.spv" for name in names | tracing}


def test_sdist_has_sources_and_compiled_shaders(unpacked_sdist):
    for name in ("LICENSE", *PAGES, "pyproject.toml", "hatch_build.py", "tools/test", "tests/test_packaging.py"):
        assert (unpacked_sdist / name).is_file(), name
    compiled = {path.relative_to(unpacked_sdist / "glsl").as_posix() for path in unpacked_sdist.rglob("*.spv")}
    assert compiled == compiled_modules()


def test_wheel_has_package_glsl_and_compiled_shaders(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = [path for suffix in ("py", "js") for path in (ROOT / "solari_vk").rglob(f"*.{suffix}")]
    modules = {path.relative_to(ROOT).as_posix() for path in sources}
    glsl = {f"solari_vk/glsl/{path.relative_to(ROOT / 'glsl').as_posix()}" for path in (ROOT / "glsl").rglob("*.glsl")}
    shaders = {f"solari_vk/glsl/{path}" for path in entry_points()}
    compiled = {f"solari_vk/glsl/{path}" for path in compiled_modules()}
    assert modules | glsl | shaders | compiled | {"solari_vk/py.typed", "solari_vk/glsl/shipped.json"} <= names
    assert all(name.startswith(("solari_vk/", "solari_vk-")) for name in names)
    assert {name for name in names if name.endswith(".spv")} == compiled


def test_wheel_metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        texts = {Path(name).name: archive.read(name).decode() for name in archive.namelist() if ".dist-info/" in name}
    assert "solari-vk = solari_vk.cli:main" in texts["entry_points.txt"]
    assert "License-Expression: MIT" in texts["METADATA"]
    assert "MIT License" in texts["LICENSE"]
    assert "Root-Is-Purelib: true" in texts["WHEEL"]


def test_installed_wheel_needs_no_compiler(wheel, tmp_path):
    """Every shader of the wheel is there as SPIR-V for both ways to trace rays; a changed one needs a compiler."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    program = """
import sys
from pathlib import Path
from solari_vk.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root

assert glsl_root() == Path(sys.argv[1]) / "solari_vk" / "glsl", glsl_root()
for path in sys.argv[2:]:
    for features in (True, False):
        assert compile_shader(path, features=features)[:4] == b"\\x03\\x02\\x23\\x07", path
    try:
        for features in (True, False):
            compile_shader(path, ray_pipelines=True, features=features)
    except SolariError as error:
        assert "ray queries of its own" in str(error), error
        assert "/conformance/" in path, path
changed = glsl_root() / sys.argv[2]
changed.write_text(changed.read_text() + "// changed\\n")
try:
    compile_shader(sys.argv[2])
except SolariError:
    print("done")
"""
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path, *entry_points()],
        cwd=tmp_path, env=os.environ | NO_COMPILER, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.strip() == "done", done.stdout + done.stderr


def test_build_without_compiler_and_without_modules_warns(tree, tmp_path):
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy, ignore=shutil.ignore_patterns("*.spv", "shipped.json", "dist"))
    names = zipfile.ZipFile(build(copy, "wheel", **NO_COMPILER)).namelist()
    assert f"solari_vk/glsl/{entry_points()[0]}" in names
    assert not [name for name in names if name.endswith(".spv")]


def test_shader_that_does_not_compile_ends_the_build(tree, tmp_path):
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy, ignore=shutil.ignore_patterns("*.spv", "shipped.json", "dist"))
    (copy / "glsl" / "broken.comp").write_text("#version 460\nvoid main() { nonsense }\n")
    with pytest.raises(AssertionError, match=r"broken\.comp:2"):
        build(copy, "wheel", SOLARI_VK_CACHE="off")
