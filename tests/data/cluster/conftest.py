"""Workers in processes of their own, with a real scheduler, that the tests of this folder share."""

from __future__ import annotations

import pytest

pytest.importorskip("distributed")

from solari_vk.data.cluster import WorkerPool


@pytest.fixture(scope="session")
def pool(any_device):
    """Two workers, which validate as all devices of the suite do."""
    with WorkerPool(workers=2) as opened:
        yield opened
