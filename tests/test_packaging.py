"""The sdist, the wheel that is built from it, and shaders that run without a compiler.

By default with a few shaders of each kind; with all of them, which takes minutes, where tests are slow.
"""

from __future__ import annotations

import os
import py_compile
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
from solari_vk.gpu.shaders.compiler import has_many_views

ROOT = Path(__file__).resolve().parents[1]
STAGES = {"." + stage for stage in shaderc.STAGES}
NO_COMPILER = {"SOLARI_VK_SHADERC": os.devnull, "PATH": "", "SOLARI_VK_CACHE": "off"}
PAGES = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"]
PARTS = ["solari_vk", "glsl", "tests", "tools", "docs", "pyproject.toml", "hatch_build.py", "LICENSE", *PAGES]
# Shaders without rays, with trace.glsl, with features of scenes, and with ray queries of their own.
FEW = re.compile(r"scene/|passes/(layout\.comp|bare_rays/|display/|conformance/trace\.comp)")

# Later Pythons ask for a filter, which Python 3.11.2 of Debian 12 doesn't know yet.
SAFELY = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}


def run(*command: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *command], cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )


def build(folder: Path, target: str, **environment: str) -> Path:
    """The file that hatchling builds from a source tree."""
    done = run("-m", "hatchling", "build", "-t", target, cwd=folder, **environment)
    assert done.returncode == 0, done.stdout + done.stderr
    (made,) = (folder / "dist").glob("*.whl" if target == "wheel" else "*.tar.gz")
    return made


def test_addresses_can_be_filled_in():
    """The lines that are comments for whoever publishes the package are right once the signs are removed."""
    text = (ROOT / "pyproject.toml").read_text()
    lines = text[text.index("# [project.urls]") :].partition("\n\n")[0]
    filled = text.replace(lines, re.sub("(?m)^# ", "", lines).replace('""', '"https://example.org"'))
    assert len(tomllib.loads(filled)["project"]["urls"]) == 5


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("CHANGELOG.md", "## 1.2.0, not released yet", "give 1.2.0 its date"),
        ("CITATION.cff", "version: 1.1.0", "version must be 1.2.0"),
        ("solari_vk/__init__.py", "", "there is no __version__"),
        ("new.py", "", "not committed"),
    ],
)
def test_a_version_that_is_not_ready_is_not_built(tmp_path, file, text, message):
    texts = {
        "CHANGELOG.md": "## 1.2.0, 2027-01-31",
        "CITATION.cff": "version: 1.2.0",
        "new.py": None,
        "solari_vk/__init__.py": '__version__ = "1.2.0"',
        "tools/release": None,
    }
    for name, content in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        if content is not None:
            (tmp_path / name).write_text(content + "\n")
    shutil.copy(ROOT / "tools/release", tmp_path / "tools")
    subprocess.run(
        "git init -q && git add . && git -c user.name=a -c user.email=a@b.c commit -qm a",
        shell=True,
        cwd=tmp_path,
        check=True,
    )
    (tmp_path / file).write_text(text + "\n")
    done = subprocess.run(["tools/release"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, message in done.stderr) == (1, True), done.stderr


def test_public_names_need_no_source(tmp_path):
    """They are those of the imports for type checkers, also where there is compiled code alone."""
    source = ROOT / "solari_vk/__init__.py"
    py_compile.compile(source, tmp_path / "solari_vk/__init__.pyc", doraise=True)
    done = run("-c", "import solari_vk; print(*solari_vk._MODULES.items(), sep='\\n')", cwd=tmp_path, PYTHONPATH="")
    imports = re.findall(r"^    from (\S+) import (\w+) as \2$", source.read_text(), re.MULTILINE)
    assert done.stdout.splitlines() == [str((name, module)) for module, name in imports], done.stderr


def entry_points(tree: Path) -> list[str]:
    glsl = tree / "glsl"
    return sorted(path.relative_to(glsl).as_posix() for path in glsl.rglob("*") if path.suffix in STAGES)


@pytest.fixture(scope="module", params=["few", pytest.param("all", marks=pytest.mark.slow)])
def tree(request, tmp_path_factory):
    """A copy of the sources, with a compiled module that belongs to no shader."""
    copy = tmp_path_factory.mktemp("tree")
    ignored = shutil.ignore_patterns("__pycache__", "*.spv", "shipped.json", ".*_cache", "*.npz")
    for name in PARTS:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=ignored)
        elif (ROOT / name).is_file():
            shutil.copy(ROOT / name, copy / name)
    shutil.copy(ROOT / ".gitignore", copy)
    for path in entry_points(copy) if request.param == "few" else ():
        if not FEW.match(path):
            (copy / "glsl" / path).unlink()
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


def compiled_modules(tree: Path) -> set[str]:
    """The files of all modules: each shader's, for shaders that trace another one for ray pipelines, and those for
    scenes without features, which shaders of scenes have, and for many views."""
    sources = shader_cache.Sources([tree / "glsl"])
    paths = {path: sources.closure(path) for path in entry_points(tree)}
    traces = {path for path, closure in paths.items() if "scene/trace.glsl" in closure}
    plain = {path for path, closure in paths.items() if "generated/bound/features.glsl" in closure}
    assert 1 < len(traces) < len(plain) < len(paths)
    many = {path for path in paths if has_many_views(path, sources)}
    assert 1 < len(many) < len(paths)
    suffixes = {
        path: [
            f"{views}{features}{rays}"
            for views in ("", ".views")[: 1 + (path in many)]
            for features in ("", ".plain")[: 1 + (path in plain)]
            for rays in ("", ".pipeline", ".compute")[: 3 if path in traces else 1]
        ]
        for path in paths
    }
    return {f"{path}{suffix}.spv" for path, each in suffixes.items() for suffix in each}


def test_sdist_has_sources_and_compiled_shaders(tree, unpacked_sdist):
    for name in ("LICENSE", *PAGES, "pyproject.toml", "hatch_build.py", "tools/test", "tests/test_packaging.py"):
        assert (unpacked_sdist / name).is_file(), name
    compiled = {path.relative_to(unpacked_sdist / "glsl").as_posix() for path in unpacked_sdist.rglob("*.spv")}
    assert compiled == compiled_modules(tree)


def test_wheel_has_package_glsl_and_compiled_shaders(tree, wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    modules = {
        path.relative_to(ROOT).as_posix()
        for suffix in ("py", "js", "toml")
        for path in (ROOT / "solari_vk").rglob(f"*.{suffix}")
    }
    libraries = {path.relative_to(tree / "glsl").as_posix() for path in (tree / "glsl").rglob("*.glsl")}
    compiled = compiled_modules(tree)
    shaders = {f"solari_vk/glsl/{path}" for path in {*libraries, *entry_points(tree), *compiled, "shipped.json"}}
    assert modules | shaders | {"solari_vk/py.typed"} <= names
    assert all(name.startswith(("solari_vk/", "solari_vk-")) for name in names)
    assert {name for name in names if name.endswith(".spv")} == {f"solari_vk/glsl/{path}" for path in compiled}


def test_wheel_metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        texts = {Path(name).name: archive.read(name).decode() for name in archive.namelist() if ".dist-info/" in name}
    for file, text in (
        ("entry_points.txt", "solari-vk = solari_vk.cli:main"),
        ("LICENSE", "MIT License"),
        ("METADATA", "License-Expression: MIT"),
        ("WHEEL", "Root-Is-Purelib: true"),
    ):
        assert text in texts[file]


def test_installed_wheel_needs_no_compiler(tree, wheel, tmp_path):
    """Every shader of the wheel is there as SPIR-V for all ways to trace rays; a changed one needs a compiler."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    program = """
import sys
from pathlib import Path
from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root

assert glsl_root() == Path(sys.argv[1]) / "solari_vk" / "glsl", glsl_root()
for path in sys.argv[2:]:
    for features in (True, False):
        assert compile_shader(path, features=features)[:4] == b"\\x03\\x02\\x23\\x07", path
    for rays in ("pipeline", "compute"):
        try:
            for features in (True, False):
                compile_shader(path, rays=rays, features=features)
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
    done = run("-c", program, tmp_path, *entry_points(tree), cwd=tmp_path, **NO_COMPILER)
    assert done.stdout.strip() == "done", done.stdout + done.stderr


@pytest.fixture
def uncompiled(tree, tmp_path):
    ignored = shutil.ignore_patterns("*.spv", "shipped.json", "dist")
    return Path(shutil.copytree(tree, tmp_path / "tree", ignore=ignored))


def test_build_without_compiler_and_without_modules_has_sources(uncompiled):
    names = zipfile.ZipFile(build(uncompiled, "wheel", **NO_COMPILER)).namelist()
    assert f"solari_vk/glsl/{entry_points(uncompiled)[0]}" in names
    assert not [name for name in names if name.endswith(".spv")]


def test_shader_that_does_not_compile_ends_the_build(uncompiled):
    (uncompiled / "glsl" / "broken.comp").write_text("#version 460\nvoid main() { nonsense }\n")
    with pytest.raises(AssertionError, match=r"broken\.comp:2"):
        build(uncompiled, "wheel", SOLARI_VK_CACHE="off")


def test_dockerfiles_copy_what_is_there_and_install_what_there_is():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for path in sorted((ROOT / "docker").iterdir()):
        text = path.read_text()
        sources = [word for line in re.findall(r"^COPY (?!--from)(.*) \S+$", text, re.M) for word in line.split()]
        assert sources
        assert all((ROOT / source).exists() for source in sources), path.name
        for named in re.findall(r"\.whl\)\[([\w,]+)\]", text):
            assert set(named.split(",")) <= set(extras), path.name
    assert "NVIDIA_DRIVER_CAPABILITIES=graphics" in (ROOT / "docker/nvidia.Dockerfile").read_text()


def test_all_is_what_users_want():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = set(",".join(re.findall(r"\[([\w,]+)\]", " ".join(project["all"]))).split(","))
    assert named == set(project) - {"all", "slang", "trial", "docs", "test"}
