"""Acceleration structures: bottom and top level, builds, refits, compaction."""
