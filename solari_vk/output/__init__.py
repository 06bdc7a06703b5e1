"""Pictures and movies: tone mapping, files, camera animations."""
