"""Devices that a test may break, and a GLSL root for a test's own shaders."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from shader_folder import ShaderFolder, check_spirv

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders import shaderc


@pytest.fixture
def shaders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ShaderFolder]:
    """An empty GLSL root and cache. Every module compiled during the test is checked with spirv-val."""
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path / "cache"))
    folder = ShaderFolder(tmp_path / "glsl")
    compile_source: Callable[..., bytes] = shaderc.compile_source

    def compile_and_keep(source: bytes, stage: str, name: str, *arguments: object, **options: object) -> bytes:
        spirv = compile_source(source, stage, name, *arguments, **options)
        folder.compiled.append((spirv, name))
        return spirv

    monkeypatch.setattr(shaderc, "compile_source", compile_and_keep)
    yield folder
    for spirv, name in folder.compiled:
        check_spirv(spirv, name)


@pytest.fixture(scope="session")
def device(bound_device: Device) -> Device:
    """The tests of this folder are about barriers too."""
    return bound_device


@pytest.fixture
def own_device(any_device: None) -> Iterator[Device]:
    """A device that the test may break."""
    with Device(validation=True) as opened:
        yield opened
