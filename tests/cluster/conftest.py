"""Workers in processes of their own, with a real scheduler, that the tests of this folder share."""

from __future__ import annotations

import pytest

pytest.importorskip("distributed")

from solari_vk.cluster import Crew


@pytest.fixture(scope="session")
def crew(any_device):
    """Two workers, which validate as all devices of the suite do."""
    with Crew(workers=2) as opened:
        yield opened
