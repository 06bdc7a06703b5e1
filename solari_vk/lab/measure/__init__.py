"""Benchmarks: speed, the realtime frame in figures, the claims of the posts."""
