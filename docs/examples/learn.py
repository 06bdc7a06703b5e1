"""Random pictures, and a small network that learns on the CPU where the block is in them. `python learn.py`."""
import json
from pathlib import Path

import numpy as np
from torch import arange, cartesian_prod, manual_seed, nn, optim, set_num_threads
from torch.utils.data import DataLoader, random_split

import solari_vk as sv
from solari_vk.cli import main

FILES = {"labels": {"short block": "block"}, "cameras": [sv.builtin("cornell_box").camera.pose()] * 120}
FILES["randomize"] = {"materials": {"block": {"base_color": [[0.1, 0.1, 0.1], [1, 1, 1]]}}, "instances": {
    "short block": {"offset": [[-0.2, 0, -0.1], [0.9, 0, 0.9]], "turn": [0, 360]}, "tall block": {"visible": False}}}


class Places(sv.Views):  # pictures, and where the block's center is in them, in pixels
    def __getitem__(self, number):
        u, v, w = self.cameras[number].intrinsics(self.size) @ self.objects(number)[0]["center"]
        return np.moveaxis(super().__getitem__(number)["rgb"], -1, 0).copy(), np.float32((u / w, v / w))


def train(views, epochs=15):  # yields the mean error in pixels before each epoch, in pictures kept apart
    set_num_threads(1), manual_seed(1)
    parts = [part for count in (3, 16, 16) for part in (nn.Conv2d(count, 16, 5, padding=2), nn.ReLU())]
    network = nn.Sequential(*parts, nn.Conv2d(16, 1, 5, padding=2))
    at, adam = cartesian_prod(*map(arange, views.size[::-1])).flip(1).float(), optim.Adam(network.parameters(), 4e-3)
    for learns, part in list(enumerate(random_split(list(views), [0.2, 0.8]))) * epochs:
        for pictures, places in DataLoader(part, 8 if learns else len(part), shuffle=bool(learns)):
            error = (network(pictures).flatten(1).softmax(1) @ at - places).norm(dim=1).mean()
            (adam.zero_grad(), error.backward(), adam.step()) if learns else (yield error.item())


if __name__ == "__main__":
    for name, value in FILES.items():
        Path("blocks").mkdir(exist_ok=True), Path(f"blocks/{name}.yaml").write_text(json.dumps(value))
    files = [f"--{name}=blocks/{name}.yaml" for name in FILES]
    main(["dataset", "builtin:cornell_box", "--size=32x24", "--samples=8", "--annotations=objects", "-oblocks", *files])
    print([f"{error:.1f} pixels off" for error in train(Places("blocks", ["rgb"]))])
