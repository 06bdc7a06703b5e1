"""Acceleration structures: bottom and top level, builds, refits and compaction."""
