"""Benchmarks: speed, and the realtime frame in figures."""
