"""Trees of boxes over triangles and instances, which compute shaders build and traverse."""
