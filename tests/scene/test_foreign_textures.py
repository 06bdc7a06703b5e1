"""Textures as other programs have them, and files that stand for something else."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from support.files import image_file

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_regular

CODES = np.random.default_rng(1).integers(0, 256, (4, 6, 4), np.uint8)
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl leaf\nf 1/1 2/2 3/3\n"


def pixels(values):
    return sv.TextureImage(values).pixels


def test_arrays_of_other_programs():
    """16 bits, as OpenCV and tifffile read them, and one channel as (height, width, 1)."""
    gray = CODES[..., 0]
    expected = np.dstack([gray] * 3 + [np.full_like(gray, 255)])
    for values in (gray, gray[..., None], 257 * gray.astype(np.uint16), (gray / 255)[..., None]):
        assert np.array_equal(pixels(values), expected)
    assert np.array_equal(pixels(257 * CODES.astype(np.uint16)), CODES)
    with pytest.raises(SolariError, match=r"\(height, width\[, 1, 3 or 4\]\)"):
        pixels(np.zeros((2, 2, 2), np.uint16))


@pytest.mark.parametrize("kind", ["tga", "bmp", "tiff", "gif"])
def test_pictures_of_obj(tmp_path, kind):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "a.mtl").write_text(f"newmtl leaf\nmap_Kd a.{kind}\n")
    colors = np.repeat(CODES[:1, :1, :3], 16, axis=1)  # which a palette has too
    Image.fromarray(colors).save(tmp_path / f"a.{kind}")
    scene = sv.load(tmp_path / "a.obj")
    assert scene.warnings == []
    assert np.array_equal(scene.materials[0].base_color_texture.image.pixels[..., :3], colors)
    assert np.array_equal(pixels(tmp_path / f"a.{kind}")[..., :3], colors)


def test_masks_of_obj(tmp_path):
    """The alpha of map_d, or its gray values; cut out where nearly all is there or not, else blended."""
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "kd.png").write_bytes(image_file(CODES[..., :3]))
    steps, ramp = np.array([[0, 255]], np.uint8), np.array([[0, 128]], np.uint8)
    for values, mode in ((steps, "mask"), (ramp, "blend"), (np.dstack([CODES[:1, :2, :3], steps[..., None]]), "mask")):
        (tmp_path / "d.png").write_bytes(image_file(values))
        for base in ("", "map_Kd kd.png\n"):
            (tmp_path / "a.mtl").write_text(f"newmtl leaf\n{base}map_d d.png\n")
            (leaf,) = sv.load(tmp_path / "a.obj").materials
            found = leaf.base_color_texture.image.pixels
            assert leaf.alpha_mode == mode
            assert found[0, [0, -1], 3].tolist() == [0, values[0, 1] if values.ndim == 2 else 255]
            assert np.array_equal(found[..., :3], CODES[..., :3] if base else np.full((1, 2, 3), 255))


def test_pointers_and_splats_are_named(tmp_path, writer):
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"
    for name in ("a.glb", "a.obj", "a.ply", "a.png"):
        (tmp_path / name).write_bytes(pointer)
        with pytest.raises(SolariError, match=r"a pointer of Git LFS.*git lfs pull"):
            sv.TextureImage(tmp_path / name) if name == "a.png" else sv.load(tmp_path / name)
    for length in (36, 10_000):  # of a buffer, which may be shorter or longer than the pointer
        with pytest.raises(SolariError, match=r"a pointer of Git LFS"):
            read_regular(tmp_path / "a.glb", "a.bin", length)
    for name in ("a.spz", "a.splat"):
        with pytest.raises(SolariError, match="compressed Gaussian splats is not read"):
            sv.load(tmp_path / name)
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty uint packed_position\nend_header\n1\n"
    (tmp_path / "a.ply").write_text(head)
    with pytest.raises(SolariError, match="compressed Gaussian splats"):
        sv.load(tmp_path / "a.ply")
    compressed = {"KHR_gaussian_splatting": {"extensions": {"KHR_gaussian_splatting_compression_spz_2": {}}}}
    writer.mesh(mode=0, extensions=compressed)
    with pytest.raises(SolariError, match="mesh 0, primitive 0 has compressed Gaussian splats"):
        writer.load()


def test_a_missing_buffer_is_noticed_before_images_are_read(writer, monkeypatch):
    def decode(*_, **__):
        raise AssertionError("an image was decoded")

    monkeypatch.setattr("solari_vk.scene.images.image_files.decode", decode)
    material = writer.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": writer.image(CODES)}})
    writer.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=material)
    writer.json["buffers"] = [{"byteLength": 4, "uri": "gone.bin"}]
    with pytest.raises(SolariError, match=r"needs the file 'gone\.bin'"):
        writer.load()
