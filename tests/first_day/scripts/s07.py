# ruff: noqa
# HDRI rotation sweep
import solari_vk as sv, math

s = sv.load("../shared/assets/FlightHelmet/FlightHelmet.gltf")
s.environment = sv.Environment("../shared/assets/hdri/spiaggia_di_mondello_1k.hdr")
with sv.Device() as d, sv.Renderer(d, s, (320, 180)) as r:
    for k in range(8):
        s.environment.rotation = k * math.pi / 4
        for _ in range(8):
            f = r.render()
        f.save(f"hdri{k}.png")
