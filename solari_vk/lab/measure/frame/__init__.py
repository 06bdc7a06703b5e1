"""Figures of the realtime frame: `solari-vk bench frame`."""
