"""Plays the animations of the scene: which clip, at what time, and whether the time runs."""

from __future__ import annotations

from solari_vk.scene.model import Animation, Scene


class Player:
    """The clip that is shown and its time. The scene has its file's pose until the user plays or scrubs a clip."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.playing = False
        self._number = 0
        self.seconds = 0.0
        self.posed = False
        """Whether the scene has been posed by a clip."""

    @property
    def number(self) -> int:
        """Of the chosen clip, among the scene's animations; the last one's if there are fewer now."""
        return max(min(self._number, len(self._scene.animations) - 1), 0)

    @property
    def clip(self) -> Animation | None:
        """The chosen clip, None in a scene without animations."""
        clips = self._scene.animations
        return clips[self.number] if clips else None

    def advance(self, seconds: float) -> None:
        """Let the time run, if it does."""
        if self.playing and self.clip is not None:
            self.show(self.seconds + seconds)

    def choose(self, number: int) -> None:
        """Show the start of another clip."""
        self._number = number
        self.show(0.0)

    def show(self, seconds: float) -> None:
        """Pose the scene at a time of the clip, which starts again after its end.

        A pose that can't be shown ends playing, and raises SolariError.
        """
        clip = self.clip
        if clip is None:
            return
        # glTF says nothing of repetition; viewers repeat clips.
        self.seconds = seconds % clip.duration if clip.duration > 0 else 0.0
        # An edit may have made a pose impossible. Playing on would raise the error in each frame.
        try:
            clip.apply(self._scene, self.seconds)
        except BaseException:
            self.playing = False
            raise
        self.posed = True
