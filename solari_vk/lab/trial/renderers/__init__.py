"""What runs in the processes of the renderers, some of them of another Python, which has no solari_vk."""
