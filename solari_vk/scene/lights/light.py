"""What all lights that aren't instances have in common."""

from __future__ import annotations

from solari_vk.scene.observed import Checked


class Light(Checked):
    """A light that isn't an instance. Each subclass has a row in solari_vk/bound/lights/light_kinds.py."""

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        raise NotImplementedError

    @property
    def axes(self) -> tuple[str, ...]:
        """The fields that are directions, which turn with what carries the light."""
        return ()
