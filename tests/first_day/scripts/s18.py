# ruff: noqa
# interop
import solari_vk as sv, numpy as np, torch, imageio.v3 as iio, matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from PIL import Image

s = sv.builtin("cornell_box")
with sv.Device() as d, sv.Renderer(d, s, (256, 256)) as r:
    for _ in range(4):
        f = r.render()
    t = torch.from_numpy(f["radiance"])
    print(t.shape, t.dtype, t.device)
    try:
        print("dlpack", torch.from_dlpack(f["radiance"]).shape)
    except Exception as e:
        print("dlpack", e)
    try:
        print("frame dlpack", torch.from_dlpack(f).shape)
    except Exception as e:
        print("frame dlpack", type(e), e)
    plt.imshow(f.image())
    plt.savefig("mpl.png")
    iio.imwrite("iio.png", f.image())
    Image.fromarray(f.image()).save("pil.png")
