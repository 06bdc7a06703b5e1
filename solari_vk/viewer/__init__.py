"""The interactive viewer: `Viewer`."""

from __future__ import annotations

from solari_vk.viewer.app import Viewer as Viewer
from solari_vk.viewer.window import Window as Window
