"""Writes small glTF files for tests: arrays in, JSON and binary out, in each of the format's packings."""

import base64
import io
import json
import re

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.files.gltf.saving.content import glb

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


class GltfWriter:
    """A glTF file: `json` (which tests may change) and `data`, its only buffer. `load` saves it to `path` first."""

    def __init__(self, path=None):
        self.path = path
        self.data = bytearray()
        self.json = {"asset": {"version": "2.0"}}

    def add(self, kind, **fields):
        """Append an object to a list ("nodes", "meshes", ...) and return its number."""
        self.json.setdefault(kind, []).append(fields)
        return len(self.json[kind]) - 1

    def view(self, data, **fields):
        self.data.extend(b"\0" * (-len(self.data) % 4))
        offset = len(self.data)
        self.data.extend(data)
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **fields)

    def accessor(self, values, dtype="f4", stride=None, **fields):
        """An accessor of rows; `stride` spreads them out."""
        array = np.array(values, "<" + dtype)
        rows = array.reshape(len(array), -1)
        size = rows.shape[1] * rows.itemsize
        spread = np.full((len(rows), stride or size), 0xAB, np.uint8)
        spread[:, :size] = np.ascontiguousarray(rows).view(np.uint8)
        view = self.view(spread.tobytes(), **({"byteStride": stride} if stride else {}))
        fields = {"type": KINDS[rows.shape[1]], **fields}
        return self.add("accessors", bufferView=view, componentType=COMPONENTS[dtype], count=len(rows), **fields)

    def mesh(self, attributes=None, indices=None, **fields):
        """A mesh of one primitive; attributes are accessor numbers or rows of floats."""
        attributes = {"POSITION": TRIANGLE, **(attributes or {})}
        numbers = {k: v if isinstance(v, int) else self.accessor(v) for k, v in attributes.items() if v is not None}
        primitive = {"attributes": numbers, **fields}
        if indices is not None:
            primitive["indices"] = indices if isinstance(indices, int) else self.accessor(indices, "u2")
        return self.add("meshes", primitives=[primitive])

    def node(self, **fields):
        return self.add("nodes", **fields)

    def animate(self, node, path, times, values, interpolation="LINEAR", **target):
        """Add a channel to the last clip, "clip" where there is none."""
        clip = self.json.setdefault("animations", [{"channels": [], "samplers": [], "name": "clip"}])[-1]
        target |= {"path": path} | ({} if node is None else {"node": node})
        clip["channels"].append({"sampler": len(clip["samplers"]), "target": target})
        output = values if isinstance(values, int) else self.accessor(values)
        clip["samplers"].append({"input": self.accessor(times), "output": output, "interpolation": interpolation})

    def clip(self, name):
        """A clip without channels yet."""
        return self.add("animations", channels=[], samplers=[], name=name)

    def image(self, pixels, format="PNG", **options):
        """A texture (image, no sampler) of pixels (h, w, c)."""
        file = encoded(pixels, format, **options)
        image = self.add("images", bufferView=self.view(file), mimeType="image/" + format.lower())
        return self.add("textures", source=image)

    def scene(self, *nodes):
        self.json["scene"] = self.add("scenes", nodes=list(nodes))

    def finish(self):
        """The JSON with the buffer; by default with a node for each mesh, and a scene of all nodes."""
        if self.data:
            self.json.setdefault("buffers", [{"byteLength": len(self.data)}])
        if "meshes" in self.json:
            self.json.setdefault("nodes", [{"mesh": number} for number in range(len(self.json["meshes"]))])
        if "scenes" not in self.json and "nodes" in self.json:
            children = {c for node in self.json["nodes"] for c in node.get("children", [])}
            self.scene(*(n for n in range(len(self.json["nodes"])) if n not in children))
        return self.json

    def glb(self):
        return glb(json.dumps(self.finish()).encode(), bytes(self.data))

    def load(self, **options):
        return load_gltf(self.save(self.path), **options)

    def load_with_loss(self, message):
        """The scene of a file of which a part is wrong, which is reported; with `strict` it is an error."""
        with pytest.raises(SolariError, match=message):
            self.load(strict=True)
        scene = self.load()
        assert re.search(message, "\n".join(scene.warnings)), scene.warnings
        return scene

    def save(self, path, packing="glb"):
        """Write as "glb", "embedded" (a data URI) or "external" (a .bin beside it)."""
        if packing == "glb":
            path.write_bytes(self.glb())
            return path
        content = self.finish()
        if packing == "embedded":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        else:
            uri = path.stem + ".bin"
            path.with_suffix(".bin").write_bytes(self.data)
        content["buffers"][0]["uri"] = uri
        path.write_text(json.dumps(content))
        return path


def encoded(picture, format="PNG", **options):
    """The bytes of a file. picture: a PIL image, or pixels (h, w, c)."""
    from PIL import Image

    file = io.BytesIO()
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(np.asarray(picture, np.uint8))
    image.save(file, format=format, **options)
    return file.getvalue()
