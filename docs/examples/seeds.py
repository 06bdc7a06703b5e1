"""Noise, measured: pictures of many seeds against the variance of independent samples. `python seeds.py`."""

import numpy as np

import solari_vk as sv

LUMINANCE = np.array((0.2126, 0.7152, 0.0722))


def pictures(device, scene, seeds, size=(48, 48), samples=8):
    """Radiance (seeds, height, width, 3) of one picture for each seed, and the variance with independent samples."""
    found, variances = [], []
    binder = sv.SceneBinder(device, scene)  # holds the scene on the device once, for all of them
    for seed in seeds:
        with sv.PathTracer(device, binder, size, seed=seed) as tracer:
            frame = tracer.render(samples=samples)
            found.append(frame["radiance"])
            variances.append(frame["variance"])
    binder.destroy()
    return np.stack(found), np.mean(variances, axis=0)


if __name__ == "__main__":
    with sv.Device() as device:
        found, independent = pictures(device, sv.builtin("cornell_box"), range(16))
    np.save("seeds.npy", found)
    measured = (found @ LUMINANCE).var(axis=0, ddof=1)
    print(f"standard deviation of a pixel: {np.sqrt(measured.mean()):.4f}, "
          f"{np.sqrt(independent.mean()):.4f} of independent samples")
