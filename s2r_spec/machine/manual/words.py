"""Tests and channels as text for the person at the robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from s2r_spec.backend import Channel, Parameter


def test_words(params: Mapping[str, float], parameters: Iterable[Parameter]) -> str:
    """Return a test as text, such as ``vd = 0.2 m/s, wz = 0 rad/s``."""
    units = {parameter.name: parameter.unit for parameter in parameters}
    return ", ".join(f"{name} = {value:.6g} {units.get(name, '')}".rstrip() for name, value in params.items())


def channel_words(channels: Iterable[Channel]) -> str:
    """Return channels as text, such as ``vx [m/s] and q[12] [rad]``."""
    shown = [
        f"{c.name}{f'[{c.width}]' if c.width > 1 else ''}{f' [{c.unit}]' if c.unit else ''}" for c in channels
    ]
    return " and ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)
