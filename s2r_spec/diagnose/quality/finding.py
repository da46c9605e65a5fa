"""What a check says of the recordings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One mistake that the recordings seem to have.

    Attributes:
        code: of the check, and of the mistake ("late", "exchanged").
        channel: that it is in ("x and y"); "the tests" or "the clock" where it is in no channel.
        text: the sentence.
        imitates: what would do the same as an effect, in a few words ("a wrong clock"); "" where the mistake is no
            rival of any effect.
        same: whether an effect of the catalogue explains the recordings as well.
    """

    code: str
    channel: str
    text: str
    imitates: str = ""
    same: bool = False

    def to_json(self) -> dict[str, str]:
        """Return code, channel and text."""
        return {"code": self.code, "channel": self.channel, "text": self.text}
