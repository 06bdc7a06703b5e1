"""Renders mutated glTF files; run by test_fuzz.py in a process of its own.

    PYTHONPATH=tests:tests/reliability python tests/reliability/render_mutants.py FOLDER COUNT SEED KIND...

Of each kind, mutants are made until COUNT have loaded. What each of these holds is added to one scene, which the
realtime renderer and the path tracer show in 16x16 pixels under validation, at three times of the mutant's first clip.
Pictures must be finite, errors must be SolariErrors, and nothing may be left on the device; a mutant may take 20
seconds, after which this process ends. The last line counts. After a failure FOLDER/KIND has the mutant.
"""

from __future__ import annotations

import faulthandler
import json
import random
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from fuzz_subjects import open_subject

import solari_vk as sv
from solari_vk.base.errors import DeviceError, ValidationError
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.features import Features
from solari_vk.gpu.shaders.compiler import COMMON_FEATURES
from solari_vk.scene.lights.environment import EnvironmentLight

SIZE = (16, 16)
SECONDS = 20
FRAMES = 2


class Stage:
    """The scene that mutants are added to, and its renderers."""

    def __init__(self, device: sv.Device) -> None:
        self.device, self.scene = device, sv.Scene()
        self.binder = SceneBinder(device, self.scene)
        self.realtime = sv.Renderer(device, self.binder, SIZE)
        self.tracer = sv.PathTracer(device, self.binder, SIZE)
        self.show(sv.builtin("cornell_box"))  # compiles

    def show(self, mutant: sv.Scene) -> str:
        """Render a mutant: "rendered", or "refused" if a renderer says what is wrong with it."""
        try:
            with self._added(mutant):
                self.realtime.reset()
                for seconds in (0.0, 0.3, 7.0) if mutant.animations else (0.0,):
                    if mutant.animations:
                        mutant.animate(seconds, loop=False)
                    self._render(mutant.camera_for(1.0))
        except (DeviceError, ValidationError):
            raise
        except sv.SolariError as error:
            print(f"refused: {error}")
            return "refused"
        finally:
            self.device.wait_idle()
            self.device.check_messages()
        return "rendered"

    @contextmanager
    def _added(self, mutant: sv.Scene) -> Iterator[None]:
        added = [*mutant.instances, *(light for light in mutant.lights if not isinstance(light, EnvironmentLight))]
        try:
            self.scene.environment = mutant.environment
            for item in added:
                self.scene.add(item)
            yield
        finally:
            self.scene.environment = None
            for item in added:
                if item in self.scene.instances or item in self.scene.lights:
                    self.scene.remove(item)

    def _render(self, camera: sv.Camera) -> None:
        for _ in range(FRAMES):
            frame = self.realtime.render(camera)
        for picture in (frame, self.tracer.render(camera, samples=2)):
            assert np.isfinite(picture["radiance"]).all(), "the picture isn't finite"
            assert not np.isnan(picture["depth"]).any(), "a depth is NaN"

    def close(self) -> None:
        self.realtime.close()
        self.tracer.close()
        self.binder.destroy()
        self.device.wait_idle()
        assert self.device.objects_in_use == 0, f"{self.device.objects_in_use} objects are left on the device"


def features_of(kind: str, folder: Path) -> frozenset[str]:
    """The features of what a kind's file has before it is mutated."""
    folder.mkdir()
    scene, features = sv.load(open_subject(kind, folder).named), Features()
    for item in (*scene.lights, *(part for one in scene.instances for part in (one, one.mesh, one.material))):
        features.add_of(item)
    return features.constants | COMMON_FEATURES


def fuzz(kind: str, folder: Path, count: int, seed: str, stage: Stage) -> Counter[str]:
    """What came of each mutant of a kind."""
    folder.mkdir()
    subject = open_subject(kind, folder)
    counts = Counter[str]()
    number = 0
    while counts["rendered"] + counts["refused"] < count:
        subject.write(random.Random(f"{seed} {kind} {number}"))
        number += 1
        faulthandler.dump_traceback_later(SECONDS, exit=True)
        try:
            mutant = sv.load(subject.named)
        except sv.SolariError:
            counts["not loaded"] += 1
            continue
        counts[stage.show(mutant)] += 1
    faulthandler.cancel_dump_traceback_later()
    return counts


def main() -> None:
    folder = Path(sys.argv[1])
    count = int(sys.argv[2])
    seed = sys.argv[3]
    kinds = sys.argv[4:]
    warnings.simplefilter("ignore", UserWarning)
    # The scene has the features of all kinds from the start, so that pipelines are compiled once.
    features = frozenset.union(*(features_of(kind, folder / f"{kind} as it should be") for kind in kinds))
    Features.add_of = lambda self, item: setattr(self, "constants", features)  # type: ignore[method-assign]
    with sv.Device(validation=True) as device:
        stage = Stage(device)
        counts = {kind: fuzz(kind, folder / kind, count, seed, stage) for kind in kinds}
        stage.close()
    print(json.dumps(counts))


if __name__ == "__main__":
    main()
