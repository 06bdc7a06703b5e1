"""Patched shaders: replaced text, refused patches, and no effect after the context."""

from __future__ import annotations

import pytest
from support.patches import patched_shaders, write_patched

from solari_vk.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root, roots

MATH, DECAY = "common/math.glsl", "passes/world_cache/decay.comp"
GUARD = "#ifndef COMMON_MATH_GLSL"


def test_an_include_is_patched_while_the_context_is_open():
    before = compile_shader(DECAY)
    with patched_shaders((DECAY, "life - 1u", "life - 2u")):
        changed = compile_shader(DECAY)
        with patched_shaders((DECAY, "life - 2u", "life - 3u")):
            assert compile_shader(DECAY) not in (before, changed)
        assert compile_shader(DECAY) == changed != before
    assert compile_shader(DECAY) == before
    assert roots() == [glsl_root()]


def test_only_patched_files_are_written(tmp_path):
    folder = write_patched(tmp_path, (MATH, GUARD, f"// first\n{GUARD}"), (MATH, "// first", "// second"))
    assert [path.relative_to(folder).as_posix() for path in folder.rglob("*.*")] == [MATH]
    assert (folder / MATH).read_text() == (glsl_root() / MATH).read_text().replace(GUARD, f"// second\n{GUARD}")


@pytest.mark.parametrize(("patch", "words"), [
    (("common/none.glsl", "a", "b"), "no shader file common/none.glsl"),
    ((MATH, "no such text", ""), "exactly once, not 0 times: 'no such text'"),
    ((MATH, "float", ""), "exactly once, not [0-9]+ times: 'float'"),
])  # fmt: skip
def test_a_patch_that_does_not_fit_is_refused(patch, words):
    with pytest.raises(SolariError, match=words), patched_shaders(patch):
        pass
    assert roots() == [glsl_root()]
