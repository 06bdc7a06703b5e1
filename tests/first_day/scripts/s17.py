# ruff: noqa
# 4k
import solari_vk as sv, resource

s = sv.builtin("cornell_box")
with sv.Device() as d, sv.PathTracer(d, s, (3840, 2160)) as t:
    t.render(samples=1).save("4k.png")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, "GB")
