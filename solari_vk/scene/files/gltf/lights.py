"""Lights of a glTF file: KHR_lights_punctual and EXT_lights_ies."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from solari_vk.scene.checks import LARGEST_COORDINATE, FloatArray
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.extras import read_extras
from solari_vk.scene.files.gltf.nodes import PlacedNode
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, shown
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.matrices import upright

EXTENSION = "KHR_lights_punctual"
PROFILES = "EXT_lights_ies"
MAX_INTENSITY = 1e15  # in lux or cd, of the scene's lights
MIN_RANGE, MAX_RANGE = 1e-5, 1e18  # in meters, of the scene's lights; the latter is no limit
LIGHT_EXTRAS = ("radius", "blocks_light", "angular_diameter")
"""The fields that glTF has no word for. `Scene.save` writes them as `extras`."""
PROFILE_EXTRAS = ("radius", "blocks_light", "range")
HARD_EDGE = 1e-3  # how much smaller the inner cone is made where a file has none that is smaller


class Lights:
    """Makes the lights of nodes."""

    def __init__(self, document: Document, report: Report) -> None:
        self._document = document
        self._report = report
        self._entries: list[Entry] | None = None
        self._profiles: dict[int, LightProfile] = {}

    def light(self, node: PlacedNode) -> Light | None:
        """The light of a node, which has the extension; None when it is left out, which is reported."""
        entry = self.entry(node)
        kind = entry.text("type", None, ("directional", "point", "spot"))
        fields = self.fields(entry)
        place = upright(node.world)
        x, y, z = node.world[:3, 3]
        if not max(abs(x), abs(y), abs(z)) <= LARGEST_COORDINATE or (place is None and kind != "point"):
            self._report.add("lights whose node's transform is singular are left out", node.entry.place)
            return None
        # Suns have an angular diameter, lamps a radius.
        fields |= read_extras(entry, LIGHT_EXTRAS[2:] if kind == "directional" else LIGHT_EXTRAS[:2])
        fields["name"] = node.entry.name or entry.name
        if kind == "directional":
            return DirectionalLight(direction=_travel(place), **fields)
        position = node.world[:3, 3]
        return PointLight(position, **fields) if kind == "point" else SpotLight(position, _travel(place), **fields)

    def luminaire(self, node: PlacedNode) -> Light | None:
        """The light with a profile of a node, which has the extension; None when it is left out, which is reported."""
        user = node.entry.extension(PROFILES)
        assert user is not None
        profile = self._profile(user)
        place = upright(node.world)
        if place is None or not np.abs(node.world[:3, 3]).max() <= LARGEST_COORDINATE:
            self._report.add("lights whose node's transform is singular are left out", node.entry.place)
            return None
        return PointLight(
            node.world[:3, 3],
            profile=profile,
            direction=_travel(place),
            horizontal=place[:3, 0].astype(np.float32),
            name=node.entry.name,
            **self.luminaire_fields(node.entry),
            **read_extras(user, PROFILE_EXTRAS),
        )

    def luminaire_fields(self, node: Entry) -> dict[str, Any]:
        """The fields that the extension of a node sets, but the profile, its place and name."""
        user = node.extension(PROFILES)
        assert user is not None
        peak = self._profile(user).peak
        # EXT_lights_ies: the profile's candelas times a multiplier. Its color is at most 1.
        color = np.clip(user.numbers("color", (1.0, 1.0, 1.0), low=0, high=1e6), 0, 1).astype(np.float32)
        intensity = self._limited(peak * user.number("multiplier", 1.0, low=0), user)
        return {"intensity": intensity, "color": color}

    def _profile(self, user: Entry) -> LightProfile:
        """The profile that a node's extension names."""
        number = user.integer("light")
        extension = self._document.root.extension(PROFILES)
        entries = extension.entries("lights", "light profile") if extension else []
        if number >= len(entries):
            raise user.error(f"refers to light profile {shown(number)}, but the file has only {len(entries)} of them")
        if number not in self._profiles:
            entry = entries[number]
            document = self._document
            embedded = "bufferView" in entry
            data = document.view(entry.integer("bufferView"), entry)[0] if embedded else document.resource(entry)
            remark = partial(self._report.add, place=entry.place)
            self._profiles[number] = LightProfile.parse(bytes(data), f"{document.file}: {entry.place}", remark)
        return self._profiles[number]

    def fields(self, entry: Entry) -> dict[str, Any]:
        """The fields that a light of the file sets, but its place and name."""
        kind = entry.text("type")
        intensity = self._limited(entry.number("intensity", 1.0, low=0), entry)
        color = np.array(entry.numbers("color", (1.0, 1.0, 1.0), low=0, high=1e6), np.float32)
        if kind == "directional":
            return {"illuminance": intensity, "color": color}
        reach = entry.limited("range", MAX_RANGE, low=0, limit=MAX_RANGE)
        # glTF forbids a range of 0, but programs write it and mean no limit.
        if reach < MIN_RANGE:
            reach = MAX_RANGE
            self._report.add("lights with a range of 0, which glTF forbids, reach without end", entry.place)
        found: dict[str, Any] = {"intensity": intensity, "color": color}
        found["range"] = None if reach == MAX_RANGE else reach
        if kind == "spot":
            found["inner_cone_angle"], found["outer_cone_angle"] = self._cones(entry)
        return found

    def _limited(self, intensity: float, entry: Entry) -> float:
        """An intensity that the scene's lights may have."""
        if intensity > MAX_INTENSITY:
            self._report.add(f"lights brighter than {MAX_INTENSITY:g} are dimmed to that", entry.place)
        return min(intensity, MAX_INTENSITY)

    def entry(self, node: PlacedNode) -> Entry:
        """The light of the file to which a node refers."""
        user = node.entry.extension(EXTENSION)
        # Read with the first light, so that errors in the list cost lights and not the file.
        if self._entries is None:
            extension = self._document.root.extension(EXTENSION)
            self._entries = extension.entries("lights", "light") if extension else []
        number = user.integer("light") if user else 0
        if number >= len(self._entries):
            count = len(self._entries)
            raise node.entry.error(f"refers to light {shown(number)}, but the file has only {count} of them")
        return self._entries[number]

    def _cones(self, light: Entry) -> tuple[float, float]:
        """The angles of a spotlight's inner and outer cone. Some programs write cones of the same angle."""
        spot = light.entry("spot")
        if spot is None:
            return 0.0, math.pi / 4
        inner = spot.number("innerConeAngle", 0.0, low=0, high=math.pi / 2)
        outer = spot.number("outerConeAngle", math.pi / 4, low=0, high=math.pi / 2)
        # A cone of no width would have no light.
        outer = max(outer, HARD_EDGE)
        if inner >= outer:
            self._report.add("spotlights with cones of the same angle get a hard edge", light.place)
            inner = outer * (1 - HARD_EDGE)
        return inner, outer


def _travel(place: Any) -> FloatArray:
    """The direction (3,) in which light leaves a node of this upright transform."""
    travel: FloatArray = -place[:3, 2].astype(np.float32)
    return travel
