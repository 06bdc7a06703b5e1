"""A model from all sides under studio lights, side by side in one picture. `python turntable.py [model.glb]`."""

import sys

import numpy as np

import solari_vk as sv


def turn(device, scene, views=6, size=(96, 128), frames=16):
    """Radiance (height, views * width, 3) of a scene seen from `views` directions around it."""
    camera, center = scene.camera_for(size[0] / size[1]), scene.bounds.center
    x, y, z = camera.transform[:3, 3] - center
    sv.studio_lights(scene, camera=camera)
    pictures = []
    with sv.Renderer(device, scene, size) as renderer:
        for angle in np.arange(views) * 2 * np.pi / views:
            offset = (x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle))
            camera.place(center + offset, center)
            renderer.reset()
            radiance = [renderer.render()["radiance"] for _ in range(frames)]
            pictures.append(np.mean(radiance[frames // 2 :], axis=0))  # once light has gathered
    return np.hstack(pictures)


def still_life():
    """A red box, a golden ball on it and a green ball beside it."""
    scene = sv.Scene()
    scene.add(sv.shapes.box(), sv.Material(base_color=(0.7, 0.1, 0.05), roughness=0.6), (0, 0.5, 0))
    scene.add(sv.shapes.sphere(0.4), sv.Material(base_color=(1, 0.77, 0.34), metallic=1, roughness=0.2), (0, 1.4, 0))
    scene.add(sv.shapes.sphere(0.3), sv.Material(base_color=(0.1, 0.5, 0.2), roughness=0.3), (0.9, 0.3, 0.3))
    return scene


if __name__ == "__main__":
    scene = sv.load_gltf(sys.argv[1]) if len(sys.argv) > 1 else still_life()
    with sv.Device() as device:
        sv.save_image("turntable.png", turn(device, scene), exposure=scene.camera.exposure)
