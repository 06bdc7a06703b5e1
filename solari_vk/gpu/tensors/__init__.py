"""Tensors of CUDA's libraries: `port.py` accepts them for the device, `exports.py` makes them of what it rendered."""
