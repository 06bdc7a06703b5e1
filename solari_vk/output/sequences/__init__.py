"""Denoising of sequences of frames that any renderer made."""
