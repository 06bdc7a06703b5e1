"""Folders of patched shaders, for seeded bugs."""

from __future__ import annotations

import pytest

from solari_vk.gpu.shaders.compiler import glsl_root


@pytest.fixture
def patched(tmp_path):
    """patched(file, old, new) -> a GLSL root with that file below passes/world_cache changed."""

    def patch(file, old, new):
        text = (glsl_root() / "passes/world_cache" / file).read_text()
        assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
        path = tmp_path / "passes/world_cache" / file
        path.parent.mkdir(parents=True)
        path.write_text(text.replace(old, new))
        return tmp_path

    return patch
