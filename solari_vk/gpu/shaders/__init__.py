"""Shader sources to SPIR-V: compiler, cache, reflection."""
