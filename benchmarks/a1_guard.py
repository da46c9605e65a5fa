"""Print what part of a core a guard takes at 500 Hz, while a client walks a robot through it on loopback.

    python benchmarks/a1_guard.py [--seconds 20]

The guard is a process of its own, as a run starts it, in real time. The robot sends a state of a stand every 2 ms, and
a client answers each; both are threads of this process. The issue's budget is 15 % of a core.
"""

from __future__ import annotations

import argparse
import os
import select
import signal
import socket
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from s2r_a1.datagrams import RealTimeSocket
from s2r_a1.guard import moves
from s2r_a1.guard.place import Robot
from s2r_a1.guard.start import attach, start
from s2r_a1.link import UdpLink
from s2r_a1.remote import packed
from s2r_a1.wire import A1, CLOSED_LOOP, Orders, Reading, pack, pack_reading

PERIOD = 0.002
ZERO = np.zeros(12)
STATE = Reading(
    np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 9.81]), moves.STANDING, ZERO, ZERO,
    np.full(12, 30.0), np.full(12, CLOSED_LOOP), 0, packed(),
)  # fmt: skip
ORDERS = pack(Orders(moves.STANDING, ZERO, np.full(12, 20.0), np.full(12, 0.75), ZERO), A1)


def robot(own: socket.socket) -> None:
    """Send a state every 2 ms to whoever sent a command."""
    own.setblocking(False)
    peer, began, tick = None, time.monotonic(), 0
    while True:
        tick += 1
        time.sleep(max(0.0, began + tick * PERIOD - time.monotonic()))
        try:
            while True:
                _, peer = own.recvfrom(2048)
        except BlockingIOError:
            pass
        if peer:
            own.sendto(pack_reading(STATE._replace(tick=2 * tick), A1), peer)


def answered(link: UdpLink, seconds: float) -> None:
    """Answer states for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if select.select([link], [], [], 0.1)[0] and link.read():
            link.send(ORDERS)


def used(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.bind(("127.0.0.1", 0))
    threading.Thread(target=robot, args=(own,), daemon=True).start()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["S2R_A1_RUN"] = folder
        whose = Robot("127.0.0.1", own.getsockname()[1])
        operator, hello = start(whose)
        try:
            operator.request("connect")
            operator.request("arm")
            leg = RealTimeSocket()
            attached = attach(whose, "client", port=leg.port)
            assert attached
            client, answer = attached
            leg.connect(("127.0.0.1", answer["port"]))
            link = UdpLink(leg, A1)
            client.request("stand")
            answered(link, 2.5)
            client.request("walk")
            before, rounds = used(hello["pid"]), operator.request("status")["rounds"]
            answered(link, seconds)
            status = operator.request("status")
            part = (used(hello["pid"]) - before) / seconds
            print(
                f"{status['state']}: {status['rounds'] - rounds} rounds in {seconds:g} s, {status['late']} late; "
                f"the guard took {100 * part:.1f} % of a core"
            )
            if status["reason"]:
                print(f"  {status['reason']}")
        finally:
            os.kill(hello["pid"], signal.SIGKILL)


if __name__ == "__main__":
    main()
