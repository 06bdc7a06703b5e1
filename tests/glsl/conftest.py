"""The fixture that runs this folder's shaders."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from shader_runner import ShaderRunner

from solari_vk.gpu.device.device import Device


@pytest.fixture(scope="session")
def shaders(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShaderRunner]:
    """The shader library as it is."""
    runner = ShaderRunner(device, tmp_path_factory.mktemp("shaders"))
    yield runner
    runner.close()
