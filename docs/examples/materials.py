"""Two materials on the same ball, and by how much their pictures differ. `python materials.py`."""

import numpy as np

import solari_vk as sv


def picture(device, material, size=128, samples=64):
    """Radiance (size, size, 3) of a ball under studio lights, from the path tracer."""
    scene = sv.Scene()
    scene.add(sv.shapes.sphere(radius=0.5), material, (0, 0.5, 0), name="ball")
    sv.studio_lights(scene, camera=scene.camera)
    with sv.PathTracer(device, scene, (size, size)) as tracer:
        frame = tracer.render(samples=samples)
        return frame["radiance"], frame.mask("ball")


def compare(device, first, second, **options):
    """Both pictures side by side, and the mean of each over the ball's pixels."""
    (left, ball), (right, _) = picture(device, first, **options), picture(device, second, **options)
    return np.hstack([left, right]), left[ball].mean(axis=0), right[ball].mean(axis=0)


if __name__ == "__main__":
    gold = sv.Material(base_color=(1.0, 0.77, 0.34), metallic=1.0, roughness=0.2)
    clay = sv.Material(base_color=(0.6, 0.3, 0.2), roughness=0.9)
    with sv.Device() as device:
        radiance, mean_gold, mean_clay = compare(device, gold, clay)
    sv.save_image("materials.png", radiance, exposure=sv.Camera().exposure)
    print("mean radiance of the gold ball", mean_gold, "and of the clay ball", mean_clay)
