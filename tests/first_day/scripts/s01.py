# ruff: noqa
# turntable mp4 of FlightHelmet
import solari_vk as sv, math, numpy as np

scene = sv.open("../shared/assets/FlightHelmet/FlightHelmet.gltf")
print(scene, scene.bounds)
c = scene.bounds.center
with sv.Device() as device, sv.Renderer(device, scene, (320, 180)) as r:
    frames = []
    for i in range(12):
        a = 2 * math.pi * i / 12
        cam = sv.Camera.look_at(c + np.array([math.sin(a) * 1.2, 0.3, math.cos(a) * 1.2]), c)
        for _ in range(4):
            f = r.render(cam)
        frames.append(f.image())
sv.save_video("helmet.mp4", frames, fps=12)
