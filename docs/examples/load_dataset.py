"""Views of `solari-vk dataset` as numpy arrays, with rays; torch.utils.data.DataLoader(Views(folder)) gives tensors."""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from solari_vk.cli import main


class Views:
    def __init__(self, folder):
        self.folder = Path(folder)
        self.data = json.loads((self.folder / "transforms.json").read_text())
        x, y = np.meshgrid(np.arange(self.data["w"]) + 0.5, np.arange(self.data["h"]) + 0.5)
        self.pixels = x - self.data["cx"], self.data["cy"] - y

    def __len__(self):
        return len(self.data["frames"])

    def __getitem__(self, number):
        frame = self.data["frames"][number]
        x, y = self.pixels[0] / frame["fl_x"], self.pixels[1] / frame["fl_y"]
        rays = np.stack([x, y, np.full_like(x, -1)], axis=-1)  # to depth 1
        world = np.array(frame["transform_matrix"])  # from camera; looks along -z, +y is up
        rgb = np.asarray(Image.open(self.folder / frame["file_path"]), np.float32) / 255
        layers = {name: np.load(self.folder / path) for name, path in frame["layer_paths"].items()}
        return {"rgb": rgb, "origin": world[:3, 3], "direction": rays @ world[:3, :3].T, **layers}


if __name__ == "__main__":
    (folder,) = sys.argv[1:] or ["views"]
    if not Path(folder).is_dir():  # a small one
        main(["dataset", "builtin:cornell_box", "--views=2", "--size=24x16", "--aov=depth,position", "-o", folder])
    views = Views(folder)
    print(len(views), "views of", {name: value.shape for name, value in views[0].items()})
