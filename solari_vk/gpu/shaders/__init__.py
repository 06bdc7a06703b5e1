"""From shader sources to SPIR-V: compiler, cache, generated headers, reflection."""
