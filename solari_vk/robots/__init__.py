"""Simulators' cameras with this renderer's light: MuJoCo's, Newton's and Isaac Lab's interfaces."""
