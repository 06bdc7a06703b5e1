"""The claims of the posts about Solari as measured pairs of settings: `solari-vk bench claims`."""
