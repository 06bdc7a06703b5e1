"""Frames: passes and stages, their resources, hazards and barriers, command buffers, GPU times."""
