"""The device and what it owns: instance, queue, memory, buffers, images, uploads, swapchain."""
