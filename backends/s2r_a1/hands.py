"""Put a twin into its rig or onto its floor, as a person's hands put a robot; no packet of the wire does this.

A datagram to the twin's port, from this computer: ``PREFIX`` and one JSON object, ``{"rig": 0.6}`` for a base held
0.6 m above the ground, or ``{"rig": null}`` for the floor. The twin answers with the same datagram.
"""

from __future__ import annotations

import json
import math
import select
import socket

from s2r_spec.errors import BackendError

PREFIX = b"s2r hands 1 "
"""A definition: the first bytes of such a datagram; no packet of a robot begins with them."""
LOWEST, HIGHEST = 0.2, 3.0
"""Tolerances [m]: heights of a rig. In a lower one the trunk touches its legs, and a higher one is a typing error."""
PATIENCE, TRIES = 2.0, 5
"""Budgets: time [s] for an answer, and number of requests; a twin on a busy machine may need several seconds."""


def put(host: str, port: int, rig: float | None) -> None:
    """Put a twin into its rig at a height [m], or onto its floor (None); raise BackendError if it does not answer."""
    request = encode(rig)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hands:
        hands.connect((host, port))
        for _ in range(TRIES):
            try:
                hands.send(request)
                if select.select([hands], [], [], PATIENCE)[0] and hands.recv(256) == request:
                    return
            except OSError:  # nothing listens there
                break
    raise BackendError(
        f"no twin at {host}:{port} lets s2r put it {'onto the floor' if rig is None else 'into a rig'}; "
        f"start one with: python -m s2r_a1.twin --port {port}"
    )


def encode(rig: float | None) -> bytes:
    """Return the datagram of a request."""
    return PREFIX + json.dumps({"rig": rig}).encode()


def read(data: bytes) -> tuple[float | None] | None:
    """Return the place in a datagram: (height [m] of the rig, or None for the floor,); None if it is no request."""
    if not data.startswith(PREFIX):
        return None
    try:
        rig = json.loads(data[len(PREFIX) :])["rig"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if rig is None:
        return (None,)
    valid = isinstance(rig, int | float) and math.isfinite(rig) and LOWEST <= rig <= HIGHEST
    return (float(rig),) if valid else None
