"""The table of extensions: what its page says is what the loader does."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.gltf_writer import TRIANGLE, GltfWriter

import solari_vk as sv
from solari_vk.scene.gltf import EXTENSIONS

PAGE = Path(__file__).parents[2] / "docs" / "gltf.md"


def test_the_page_shows_the_table():
    rows = "".join(f"| {name} | {status} | {remark} |\n" for name, status, remark in EXTENSIONS)
    assert PAGE.read_text().endswith("| --- | --- | --- |\n" + rows), f"the rows of docs/gltf.md must be\n{rows}"
    names = [extension.name for extension in EXTENSIONS]
    assert len(set(names)) == len(names)
    assert all(extension.remark for extension in EXTENSIONS if extension.status != "works")


@pytest.mark.parametrize("extension", EXTENSIONS, ids=lambda extension: extension.name)
def test_a_file_may_require_what_is_shown(tmp_path, extension):
    writer = GltfWriter()
    writer.node(mesh=writer.mesh({"POSITION": TRIANGLE}))
    writer.json["extensionsRequired"] = [extension.name]
    path = writer.save(tmp_path / "required.glb")
    if extension.status == "no":
        with pytest.raises(sv.SolariError, match=f"{extension.name}, which is not supported"):
            sv.load_gltf(path)
    else:
        assert len(sv.load_gltf(path).instances) == 1
