"""Seeded bugs: each fits its shader, those of slow tests too; and what `Bug` makes of a source."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from support.seeded_bugs import GLSL, KNOWN, Bug, seeded

from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.shaderc import STAGES

TESTS = Path(__file__).parent
SOURCE = """const float LIMIT = 2.0, LARGER = max(3.0, 4.0);
#define SCALE 3.0
float twice(float x) { return 2.0 * x; }
float twice(vec2 v) { return 2.0 * v.x; }
void main() { if (true) { twice(1.0); } }
"""


@pytest.fixture
def bugs(monkeypatch):
    """Every bug of the suite."""
    for path in sorted(TESTS.rglob("test_*.py")):
        if "seeded_bugs import" in path.read_text(encoding="utf-8") and path != Path(__file__):
            monkeypatch.syspath_prepend(str(path.parent))
            spec = importlib.util.spec_from_file_location(f"bugs_of_{path.stem}", path)
            module = importlib.util.module_from_spec(spec)
            monkeypatch.setitem(sys.modules, spec.name, module)
            spec.loader.exec_module(module)
    assert len(KNOWN) > 100, "the seeded bugs were not found"
    return KNOWN


def test_every_bug_fits_its_shader(bugs):
    wrong = []
    for bug in bugs:
        try:
            bug.apply((GLSL / bug.file).read_text(encoding="utf-8"))
        except (ValueError, FileNotFoundError) as error:
            wrong.append(f"{bug.file}: {bug.name}: {error}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_every_bug_compiles(bugs):
    sources = Sources([GLSL])
    entries = [path.relative_to(GLSL).as_posix() for path in GLSL.rglob("*") if path.suffix[1:] in STAGES]
    users = {entry: sources.closure(entry) for entry in entries}
    entries.sort(key=lambda entry: sum(map(len, users[entry].values())))  # small ones take the least time
    groups = []  # of bugs of different functions, which are compiled together
    for bug in bugs:
        entry, of = next(entry for entry in entries if bug.file in users[entry]), (bug.file, bug.name.partition("(")[0])
        group = next((group for known, group in groups if known == entry and of not in group), None)
        if group is None:
            group = {}
            groups.append((entry, group))
        group[of] = bug
    wrong = []
    for entry, group in groups:
        try:
            with seeded(*group.values()):
                compile_shader(entry)
        except SolariError as error:
            wrong.append(f"{entry}: {error}")
    print(f"{len(KNOWN)} bugs in {len(groups)} shaders")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("name", "text", "parts"),
    [
        ("LIMIT", "7.0", ["const float LIMIT = 7.0, LARGER = max(3.0, 4.0);"]),
        ("LARGER", "7.0", ["const float LIMIT = 2.0, LARGER = 7.0;"]),
        ("SCALE", "7.0", ["#define SCALE 7.0\n"]),
        (
            "twice(vec2",
            "return correct(v.yx);",
            [
                "float twice_without_bug(vec2 v) { return 2.0 * v.x; }\n"
                "float twice(vec2 v) { return twice_without_bug(v.yx); }",
                "float twice(float x) { return 2.0 * x; }",
            ],
        ),
        (
            "main",
            "correct(); done();",
            ["void main_without_bug() { if (true) { twice(1.0); } }\nvoid main() { main_without_"],
        ),
    ],
)
def test_a_bug_replaces_a_function_or_a_constant(name, text, parts):
    changed = Bug("common/math.glsl", name, text).apply(SOURCE)
    KNOWN.pop()
    assert all(part in changed for part in parts), changed


def test_a_name_must_be_the_only_one():
    for name in ("twice", "none"):
        bug = Bug("common/math.glsl", name, "")
        KNOWN.remove(bug)
        with pytest.raises(ValueError, match=f"must have one function or constant {name}, not"):
            bug.apply(SOURCE)


def test_bugs_hold_while_their_context_is_open():
    path, bug = "passes/world_cache/decay.comp", Bug("common/math.glsl", "square", "return x;")
    before = compile_shader("scene/layout.comp"), compile_shader(path)
    with seeded(Bug(path, "main", "")):
        assert compile_shader(path) != before[1]
        with seeded(bug):
            pass
    assert (compile_shader("scene/layout.comp"), compile_shader(path)) == before
