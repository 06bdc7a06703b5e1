"""A forked process can't use its parent's device, and says so at once; one of its own works."""

from __future__ import annotations

import os
import signal

import pytest

import solari_vk as sv
from solari_vk.base.errors import DeviceError


def in_child(action):
    """What an action returns in a forked process, which is killed after a minute."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        try:
            signal.alarm(60)
            os.write(write, action().encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as said:
        text = said.read()
    os.waitpid(child, 0)
    return text


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_the_parents_device_is_refused_and_works_on(own_device):
    with sv.Renderer(own_device, sv.builtin("cornell_box"), (16, 16)) as renderer:
        before = renderer.render()["radiance"]
        uses = {
            "render": lambda: renderer.render(),
            "read": lambda: renderer["radiance"],
            "buffer": lambda: own_device.buffer(64, "new"),
            "renderer": lambda: sv.PathTracer(own_device, sv.builtin("cornell_box"), (16, 16)),
        }

        def try_all():
            said = []
            for name, use in uses.items():
                try:
                    use()
                    said.append(f"{name} did nothing")
                except DeviceError as error:
                    said += [f"{name}: {error}"] * ("multiprocessing.get_context('spawn')" not in str(error))
            renderer.close()
            own_device.close()
            return "; ".join(said)

        assert in_child(try_all) == ""
        renderer.reset()
        assert renderer.render()["radiance"].shape == before.shape


def test_a_device_of_the_childs_own_works():
    def render():
        with sv.Device() as own, sv.PathTracer(own, sv.builtin("cornell_box"), (8, 8)) as tracer:
            return str(tracer.render(samples=1)["radiance"].shape)

    assert in_child(render) == "(8, 8, 3)"
