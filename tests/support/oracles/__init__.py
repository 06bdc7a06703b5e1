"""Independent references, written from the papers and the specification only, never from the shaders."""
