"""The compiler: its functions, error positions, generated headers, cache, shipped modules, and both ways to shaderc."""

from __future__ import annotations

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
import sys
import types
import warnings
from pathlib import Path

import pytest
from shader_folder import check_spirv

from solari_vk.base import disk_cache
from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders import compiler, dead_code, headers, shaderc
from solari_vk.gpu.shaders.compiler import CompilationError, compile_shader
from solari_vk.gpu.shaders.spirv import reflect

PLAIN = "layout(local_size_x = 1) in;\nlayout(set = 1, binding = 0, scalar) buffer B { uint at[]; } values;\n"
LIBRARY = "#ifndef L\n#define L\nuint answer() { return 42u; }\n#endif\n"
USER = '#include "lib/a.glsl"\n' + PLAIN + "void main() { values.at[0] = answer(); }\n"
GENERATED = '#include "generated/made.glsl"\n' + PLAIN + "void main() { values.at[0] = MADE; }\n"
WRITES_ONE = PLAIN + "void main() { values.at[0] = 1u; }\n"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """A module solari_vk.made whose header has one constant."""
    module = types.ModuleType("solari_vk.made")
    module.glsl_header = lambda: headers.constants(MADE=5)
    monkeypatch.setitem(sys.modules, "solari_vk.made", module)
    return module


def test_names_survive_and_paths_do_not(shaders):
    shaders.write("lib/a.glsl", LIBRARY)
    shaders.write("user", USER)
    spirv = compile_shader("passes/user.comp", root=shaders.root)
    assert set(reflect(spirv).bindings) == {"values"}
    assert str(shaders.root).encode() not in spirv
    assert b"answer()" not in spirv, "source text is left in the module"


def test_include_beside_the_including_file_goes_first(shaders):
    shaders.write("lib/a.glsl", '#include "b.glsl"\n')
    shaders.write("lib/b.glsl", "const uint BESIDE = 1u;\n")
    shaders.write("b.glsl", "#error the wrong one\n")
    shaders.write("user", '#include "lib/a.glsl"\n' + PLAIN + "void main() { values.at[0] = BESIDE; }\n")
    compile_shader("passes/user.comp", root=shaders.root)


def shown(error: CompilationError, name: str) -> tuple[str, str]:
    """Where an error says that a name is unknown, and the line that it shows."""
    lines = str(error).splitlines()
    at = next(i for i, line in enumerate(lines) if f"'{name}'" in line)
    return lines[at].partition(": error")[0], lines[at + 1].strip()


@pytest.mark.parametrize("header", ["", "const bool X = true;\nconst bool Y = false;"])
def test_errors_name_the_true_file_and_line_and_show_it(shaders, made, header):
    made.glsl_header = lambda: "const uint OTHER = 4u;\nconst uint MADE = absent;"
    shaders.write("lib/a.glsl", "#ifndef L\n#define L\n\nuint answer() { return missing; }\n#endif\n")
    shaders.write("user", USER + '#include "generated/made.glsl"\nvoid more() { gone(); }\n')
    with pytest.raises(CompilationError) as caught:
        compile_shader("passes/user.comp", header=header, root=shaders.root)
    root = shaders.root
    assert shown(caught.value, "missing") == (f"{root}/lib/a.glsl:4", "uint answer() { return missing; }")
    assert shown(caught.value, "gone") == (f"{root}/passes/user.comp:8", "void more() { gone(); }")
    assert shown(caught.value, "absent") == ("generated/made.glsl:4", "const uint MADE = absent;")
    with pytest.raises(CompilationError, match=r"user\.comp \(header\):2: error: 'tru'"):
        compile_shader("passes/user.comp", header="const bool X = true;\nconst bool Y = tru;", root=shaders.root)


def test_header_comes_before_the_code_and_makes_a_variant(shaders):
    shaders.write("user", PLAIN + "void main() { values.at[0] = VALUE; }\n")
    headers = [f"const uint VALUE = {number}u;" for number in (1, 2)]
    one, two = (compile_shader("passes/user.comp", header=header, root=shaders.root) for header in headers)
    assert one != two
    with pytest.raises(CompilationError, match="VALUE"):
        compile_shader("passes/user.comp", root=shaders.root)


def test_a_generated_header_is_what_its_module_says_and_counts_for_the_cache(shaders, made):
    shaders.write("user", GENERATED)
    first = compile_shader("passes/user.comp", root=shaders.root)
    assert compile_shader("passes/user.comp", root=shaders.root) == first
    made.glsl_header = lambda: headers.constants(MADE=6)
    assert compile_shader("passes/user.comp", root=shaders.root) != first
    assert len(shaders.compiled) == 2
    shaders.write("user", GENERATED.replace("MADE", "6u"))
    assert reflect(compile_shader("passes/user.comp", root=shaders.root)).main.writes == {"values"}


def test_calls_of_pyshaderc_include_libraries_and_generated_headers(shaders, made):
    """Two libraries include the same header, one of them through another library."""
    shaders.write("lib/a.glsl", '#ifndef A\n#define A\n#include "generated/made.glsl"\n#endif\n')
    path = shaders.write("user", "#include <lib/a.glsl>\n" + GENERATED)
    compiler.set_include_paths([shaders.root])
    try:
        from_file = compiler.compile_file_into_spirv(str(path), "comp")
        from_text = compiler.compile_into_spirv(path.read_bytes(), "comp", str(path), optimization="zero")
        assert reflect(from_file).main.writes == reflect(from_text).main.writes == {"values"}
        compiler.set_include_paths([])
        with pytest.raises(CompilationError, match=r"user\.comp:3: .*lib/a\.glsl"):
            compiler.compile_file_into_spirv(str(path), "comp")
    finally:
        compiler.set_include_paths([])
    with pytest.raises(SolariError, match="unknown stage 'pixel'"):
        compiler.compile_into_spirv("", "pixel", "x")
    with pytest.raises(SolariError, match=r"nowhere\.comp: there is no such file"):
        compiler.compile_file_into_spirv("/nowhere.comp", "comp")


def test_a_header_that_no_module_makes_is_an_error_with_file_and_line(shaders, made):
    for name, words in (
        ("nothing/here", "no module solari_vk.nothing.here"),
        ("base/errors", "no function glsl_header"),
    ):
        shaders.write("user", f'\n\n#include "generated/{name}.glsl"\nvoid main() {{}}\n')
        with pytest.raises(CompilationError, match=rf"passes/user\.comp:5: error: .*{words}"):
            compile_shader("passes/user.comp", root=shaders.root)


def test_enumerations_and_constants_are_exact():
    assert headers.enumeration("order", ("0.18", "a-b")) == "const uint ORDER_0_18 = 0u;\nconst uint ORDER_A_B = 1u;"
    assert headers.constants(A=True, B=-1, C=2**32 - 1, D=0.1, E=1e-12).splitlines() == [
        "const bool A = true;",
        "const int B = -1;",
        "const uint C = 4294967295u;",
        "const float D = 0.1;",
        "const float E = 1e-12;",
    ]
    for name, value in (("A B", 1), ("A", 2**32), ("A", float("nan")), ("A", float("inf"))):
        with pytest.raises(ValueError, match="A"):
            headers.constants(**{name: value})


def test_modules_of_generated_headers_need_no_vulkan():
    """Wheels are built on machines without Vulkan; hatch_build.py imports these modules without the package."""
    asked = set()
    for path in compiler.glsl_root().rglob("*"):
        if path.suffix.lstrip(".") in {*shaderc.STAGES, "glsl"}:
            asked |= set(re.findall(r'#\s*include\s+"(generated/[^"]+)"', path.read_text()))
    program = """
import sys, types
sys.modules["vulkan"] = sys.modules["PIL"] = sys.modules["OpenEXR"] = sys.modules["rich"] = None
package = sys.modules["solari_vk"] = types.ModuleType("solari_vk")
package.__path__ = [sys.argv[1]]
from solari_vk.gpu.shaders.headers import header_text
for name in sys.argv[2:]:
    assert header_text(name, "here")
"""
    package = str(Path(compiler.__file__).parents[2])
    command = [sys.executable, "-c", program, package, *sorted(asked)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# ---- cache ------------------------------------------------------------------------------------------


def test_cache_follows_the_include_closure_and_the_compiler(shaders, monkeypatch):
    shaders.write("lib/a.glsl", LIBRARY)
    shaders.write("user", USER)
    first = compile_shader("passes/user.comp", root=shaders.root)
    assert compile_shader("passes/user.comp", root=shaders.root) == first
    assert len(shaders.compiled) == 1
    shaders.write("lib/a.glsl", LIBRARY.replace("42u", "43u"))
    assert compile_shader("passes/user.comp", root=shaders.root) != first
    assert len(shaders.compiled) == 2
    shaders.write("lib/unrelated.glsl", "changed")
    compile_shader("passes/user.comp", root=shaders.root)
    assert len(shaders.compiled) == 2
    monkeypatch.setattr(shaderc, "version", lambda: "another compiler")
    compile_shader("passes/user.comp", root=shaders.root)
    assert len(shaders.compiled) == 3


@pytest.mark.parametrize("damage", [lambda b: b[:-4], lambda b: b""])
def test_damaged_cache_entries_are_made_again(shaders, damage):
    shaders.write("user", WRITES_ONE)
    good = compile_shader("passes/user.comp", root=shaders.root)
    folder = disk_cache.folder()
    assert folder is not None
    (entry,) = folder.glob("*.spv")
    entry.write_bytes(damage(entry.read_bytes()))
    assert compile_shader("passes/user.comp", root=shaders.root) == good
    assert len(shaders.compiled) == 2
    assert compile_shader("passes/user.comp", root=shaders.root) == good
    assert len(shaders.compiled) == 2
    assert not list(folder.glob("*.tmp"))


def test_cache_off_and_not_writable(shaders, monkeypatch, tmp_path):
    shaders.write("user", WRITES_ONE)
    monkeypatch.setenv("SOLARI_VK_CACHE", "off")
    compile_shader("passes/user.comp", root=shaders.root)
    compile_shader("passes/user.comp", root=shaders.root)
    assert len(shaders.compiled) == 2
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="SOLARI_VK_CACHE"):
        compile_shader("passes/user.comp", root=shaders.root)


# ---- shipped modules --------------------------------------------------------------------------------


def test_shipped_modules_need_no_compiler(shaders, monkeypatch, made):
    """They are used only for exactly the sources, headers and generated headers that they were made from."""
    shaders.write("lib/a.glsl", '#include "generated/made.glsl"\n' + LIBRARY)
    shaders.write("user", USER)
    assert compiler.build_all(shaders.root, shaders.root) == ["passes/user.comp"]
    index = json.loads((shaders.root / "shipped.json").read_text())
    (entry,) = index.values()
    assert hashlib.sha256((shaders.root / entry["file"]).read_bytes()).hexdigest() == entry["sha256"]

    def no_compiler(*_: object, **__: object) -> bytes:
        raise SolariError("no GLSL compiler")

    monkeypatch.setattr(shaderc, "compile_source", no_compiler)
    monkeypatch.setattr(shaderc, "version", no_compiler)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert reflect(compile_shader("passes/user.comp", root=shaders.root)).main.writes == {"values"}
    with pytest.raises(SolariError, match="no GLSL compiler"):
        compile_shader("passes/user.comp", header="const bool X = true;", root=shaders.root)
    with monkeypatch.context() as patch:
        patch.setattr(made, "glsl_header", lambda: headers.constants(MADE=6))
        with pytest.raises(SolariError, match="no GLSL compiler"):
            compile_shader("passes/user.comp", root=shaders.root)
    compile_shader("passes/user.comp", root=shaders.root)
    shaders.write("lib/a.glsl", '#include "generated/made.glsl"\n' + LIBRARY.replace("42u", "43u"))
    with pytest.raises(SolariError, match="no GLSL compiler"):
        compile_shader("passes/user.comp", root=shaders.root)


def test_variants_for_many_views_are_shipped(shaders, monkeypatch):
    shaders.write("user", '#include "passes/views.glsl"\n' + PLAIN + "void main() { values.at[0] = camera.size.x; }\n")
    compiler.build_all(shaders.root, shaders.root)
    files = {entry["file"] for entry in json.loads((shaders.root / "shipped.json").read_text()).values()}
    assert files == {"passes/user.comp.spv", "passes/user.comp.views.spv"}
    monkeypatch.setattr(shaderc, "compile_source", lambda *_, **__: pytest.fail("compiled"))
    for header, resource in (("", "camera"), (compiler.MANY_VIEWS, "views")):
        found = reflect(compile_shader("passes/user.comp", header=header, root=shaders.root))
        assert resource in found.bindings


def test_damaged_shipped_module_is_compiled_instead(shaders):
    shaders.write("user", WRITES_ONE)
    compiler.build_all(shaders.root, shaders.root)
    good = (shaders.root / "passes/user.comp.spv").read_bytes()
    (shaders.root / "passes/user.comp.spv").write_bytes(good[:-8])
    with pytest.warns(UserWarning, match="damaged"):
        assert compile_shader("passes/user.comp", root=shaders.root) == good
    (shaders.root / "shipped.json").write_text("{")
    with pytest.warns(UserWarning, match="can't be read"):
        assert compile_shader("passes/user.comp", root=shaders.root) == good


def test_build_from_the_command_line(shaders, tmp_path):
    shaders.write("user", WRITES_ONE)
    compiler = "solari_vk.gpu.shaders.compiler"
    command = [sys.executable, "-m", compiler, "--build", str(shaders.root), str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["passes/user.comp"]
    check_spirv((tmp_path / "out/passes/user.comp.spv").read_bytes(), "user")


# ---- both ways to shaderc ---------------------------------------------------------------------------


@pytest.fixture
def fresh_lookup():
    """Forget which compiler was found, before and after the test."""
    shaderc.library.cache_clear()
    shaderc.version.cache_clear()
    yield
    shaderc.library.cache_clear()
    shaderc.version.cache_clear()


def test_a_library_is_known_by_its_file_where_the_loader_does_not_tell(tmp_path, fresh_lookup, monkeypatch):
    """As on Windows: what is compiled is found again by the next process, and not after an update."""
    file = tmp_path / "shaderc_shared.dll"
    file.write_bytes(b"1")
    monkeypatch.setenv("SOLARI_VK_SHADERC", str(file))
    shaderc._declare()
    monkeypatch.setattr(shaderc, "library", lambda: object())  # has no function whose file could be asked for
    assert shaderc.version().startswith(f"{file.resolve()} 1 ")
    shaderc.version.cache_clear()
    file.write_bytes(b"22")
    assert shaderc.version().startswith(f"{file.resolve()} 2")


def test_lines_are_shown_whichever_sign_is_between_folders():
    """Windows has two; a dot stands for them here."""
    log = "folder/./a.comp:2: error: 'x' : undeclared"
    assert compiler._with_source_lines(log, "folder/a.comp", b"void main() {\n  x;\n}", {}).endswith("\n    x;")


def test_the_remedy_is_told_where_no_compiler_is_found(shaders, monkeypatch, fresh_lookup):
    shaders.write("user", WRITES_ONE)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(shaderc, "_NAMES", {"linux": ["/nowhere/libshaderc.so"]})
    for named, message in (
        (None, r"/nowhere/libshaderc\.so.*apt-get install glslc"),
        ("/nowhere/named.so", r"SOLARI_VK_SHADERC names /nowhere/named\.so, which can't be loaded"),
    ):
        shaderc.library.cache_clear()
        if named is None:
            monkeypatch.delenv("SOLARI_VK_SHADERC", raising=False)
        else:
            monkeypatch.setenv("SOLARI_VK_SHADERC", named)
        with pytest.raises(SolariError, match=message):
            compile_shader("passes/user.comp", root=shaders.root)


@pytest.fixture(scope="module")
def libshaderc(tmp_path_factory):
    """The path of a libshaderc that can be loaded.

    Debian 12's can't: it leaves symbols of glslang and SPIRV-Tools undefined. A library that depends on it and contains
    those symbols, linked from Debian's static libraries, can.
    """
    name = "libshaderc.so.1"
    try:
        ctypes.CDLL(name)
        return name
    except OSError as error:
        if "undefined symbol" not in str(error):
            pytest.fail(f"{name} isn't installed: {error}")
    folder = next((path.parent for path in Path("/usr/lib").rglob("libglslang.a")), None)
    if folder is None or shutil.which("ld") is None:
        pytest.fail(f"{name} leaves symbols undefined, and what defines them is missing: glslang-dev or binutils")
    parts = [
        "glslang",
        "MachineIndependent",
        "GenericCodeGen",
        "OSDependent",
        "OGLCompiler",
        "HLSL",
        "SPIRV",
        "SPIRV-Tools-opt",
        "SPIRV-Tools",
    ]
    whole = tmp_path_factory.mktemp("libshaderc") / "libshaderc_whole.so"
    subprocess.run(
        [
            "ld",
            "-shared",
            "-o",
            whole,
            "--defsym=__dso_handle=0",
            "-L",
            folder,
            "--no-as-needed",
            f"-l:{name}",
            "--whole-archive",
            *(folder / f"lib{part}.a" for part in parts),
        ],
        check=True,
    )
    return str(whole)


def test_library_and_command_agree(shaders, libshaderc, monkeypatch, fresh_lookup):
    shaders.write("lib/a.glsl", LIBRARY)
    path = shaders.write("user", USER)
    arguments = (path.read_bytes(), "comp", str(path), [str(shaders.root)])
    broken = (path.read_bytes() + b"void more() { absent(); }\n", *arguments[1:])
    monkeypatch.setenv("SOLARI_VK_SHADERC", libshaderc)
    modules, logs = [], []
    for program in ("libshaderc", "glslc"):
        with monkeypatch.context() as patch:
            if program == "glslc":
                patch.setattr(shaderc, "library", lambda: None)
            assert program in shaderc.version()
            modules.append(dead_code.without_texts(shaderc.compile_source(*arguments)))
            with pytest.raises(shaderc.Failure) as caught:
                shaderc.compile_source(*broken)
            logs.append([line for line in str(caught.value).splitlines() if "'absent'" in line])
        shaderc.version.cache_clear()
    assert modules[0] == modules[1]
    assert logs[0] == logs[1] != []
