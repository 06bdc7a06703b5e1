"""Renders the stored Mitsuba references again: `python -m support.make_references` in tests/ (needs LLVM 19)."""

import sys

import numpy as np

from support import mitsuba_scene
from support.references import BOUNCES, CASES, FOLDER, SIZE, fingerprint


def main():
    mitsuba = mitsuba_scene.select_variant(vectorized=True)
    if mitsuba is None:
        return "the vectorized Mitsuba needs LLVM 19 (Debian: libllvm19)"
    mitsuba_scene.register_bsdf(mitsuba)
    FOLDER.mkdir(exist_ok=True)
    for name, case in CASES.items():
        scene, lambert = case()
        made = mitsuba_scene.scene_of(mitsuba, scene, SIZE, SIZE, bounces=BOUNCES, lambert=lambert)
        mean, variance = mitsuba_scene.render(mitsuba, made, batches=32, samples=1024)
        np.savez_compressed(
            FOLDER / f"{name}.npz",
            mean=mean.astype(np.float32),
            variance=variance.astype(np.float32),
            fingerprint=fingerprint(scene),
        )
        print(f"{name}: mean {mean.mean():.6f}, relative error {np.sqrt(variance.mean()) / mean.mean() / SIZE:.5%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
