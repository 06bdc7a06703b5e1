"""Files of others that tests read: assets/ beside the checkout, or the folder that SOLARI_VK_ASSETS names."""

import os
from pathlib import Path

import pytest

_FOLDER = os.environ.get("SOLARI_VK_ASSETS")
ASSETS = Path(_FOLDER) if _FOLDER else Path(__file__).parents[3] / "shared" / "assets"


def asset(name):
    """The path of an asset; without it the test is skipped."""
    if not (ASSETS / name).exists():
        pytest.skip(f"no {name} among the assets")
    return ASSETS / name
