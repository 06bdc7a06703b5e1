"""A device for the programs of a file, which leave renderers open."""

import pytest

import solari_vk as sv


@pytest.fixture(scope="module")
def device(any_device):
    with sv.Device(validation=True) as opened:
        yield opened
