"""A twin that a test steers within its own process, by packets and without sockets."""

import numpy as np

from s2r_a1.twin import Twin, TwinSettings, read_inject
from s2r_a1.wire import A1, Orders, pack, unpack

ZERO = np.zeros(12)
LIMP = Orders(ZERO, ZERO, ZERO, ZERO, ZERO)


def twin(*injects, **settings):
    """Return a twin without effects, unless a place is named, with these injects."""
    settings.setdefault("place", "nominal")
    return Twin(TwinSettings(**settings, injects=tuple(read_inject(text) for text in injects)))


def steer(twin, orders, rounds=1):
    """Send the same orders for some rounds; return the last state that arrived."""
    command = pack(orders, A1)
    arrived = [data for _ in range(rounds) for data in twin.round([command])]
    return unpack(arrived[-1], A1)
