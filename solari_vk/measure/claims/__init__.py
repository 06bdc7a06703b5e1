"""The claims of the posts about Solari as measured pairs of before and after: `solari-vk bench claims`."""
