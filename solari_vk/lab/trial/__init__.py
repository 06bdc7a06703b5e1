"""The same scenes through other renderers: `solari-vk trial`."""
