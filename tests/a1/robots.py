"""A lock-step twin for tests of the whole chain: the twin, its guard in a process of its own, and this process."""

import contextlib
import signal
import subprocess
import sys
import threading

from s2r_a1.guard.control import Connection, ControlError
from s2r_a1.guard.place import place
from s2r_a1.twin import Twin
from s2r_a1.twin.server import Server
from s2r_a1.wire import A1, WireError, unpack_orders
from tests.processes import until


class Steered(Twin):
    """A twin that calls ``walking(n)`` before round n of a walk, and keeps the packets that came to it.

    A walk begins with torques and no gain on any angle: four feet that stand, under the controller.
    """

    def __init__(self, settings):
        super().__init__(settings)
        self.came = []
        self.walked = None
        self.walking = lambda n: None

    def rest(self):
        """Look for the next walk from here on."""
        self.walked = None

    def round(self, arrived):
        self.came += arrived
        for data in arrived:
            if self.walked is None and data:
                with contextlib.suppress(WireError):
                    orders = unpack_orders(data, A1)
                    if orders.tau.any() and not orders.kp.any():
                        self.walked = 0
        if self.walked is not None:
            self.walking(self.walked)
            self.walked += 1
        return super().round(arrived)


@contextlib.contextmanager
def served(twin, **options):
    """Serve a twin from a thread of this process, and give its port; its guard is ended with it."""
    with Server(twin, ("127.0.0.1", 0), **options) as server:
        thread = threading.Thread(target=server.serve_in_lock_step)
        thread.start()
        try:
            yield server.port
        finally:
            end_guard(server.port)
            server.stop()
            thread.join()


@contextlib.contextmanager
def in_a_process(*options):
    """Start a lock-step twin in a process of its own, and give its port; its guard is ended with it."""
    command = [sys.executable, "-m", "s2r_a1.twin", "--clock", "lockstep", "--port", "0", *map(str, options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    port = None
    try:
        line = process.stdout.readline()
        assert "twin" in line, line
        port = int(line.partition("127.0.0.1:")[2].partition(",")[0])
        yield port
    finally:
        if port is not None:
            end_guard(port)
        process.send_signal(signal.SIGTERM)
        process.wait(120.0)
        process.stdout.close()


def end_guard(port):
    """End the guard of a twin, if one lives, whatever its state."""
    found = place("127.0.0.1", port)
    try:
        connection = Connection(found.control)
    except ControlError:
        return
    with contextlib.suppress(ControlError):
        connection.request("damp", reason="the test is over")
        connection.request("stop")
    connection.close()
    until(lambda: not found.control.exists())


class Silent:
    """An operator of whom nothing is asked."""

    def __init__(self):
        self.said = []

    def say(self, text):
        self.said.append(text)

    def type_word(self, question, word):
        raise AssertionError(question)

    def choose(self, question, answers):
        raise AssertionError(question)


__all__ = ["Silent", "Steered", "end_guard", "in_a_process", "served"]
