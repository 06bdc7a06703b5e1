"""What a frame is: passes and stages, their resources, hazards, barriers, command buffers and GPU times."""
