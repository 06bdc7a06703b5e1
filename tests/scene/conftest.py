"""A writer of glTF files for the tests of the loader."""

from __future__ import annotations

import pytest
from support.files import GltfWriter


@pytest.fixture
def writer(tmp_path):
    """An empty file, which `load` saves as file.glb."""
    return GltfWriter(tmp_path / "file.glb")
