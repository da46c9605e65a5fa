"""``python -m s2r_a1.twin``: run a twin of the robot in a separate process."""

from __future__ import annotations

import sys
from argparse import Namespace
from contextlib import ExitStack

from s2r_a1.rawlog import RawLogWriter
from s2r_a1.twin.options import read_options
from s2r_a1.twin.server import Server
from s2r_a1.twin.twin import Twin
from s2r_spec.errors import BackendError, S2RError


def main(arguments: list[str]) -> int:
    """Serve until a signal arrives; return the exit status."""
    try:
        _serve(read_options(arguments), arguments)
    except S2RError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:  # before the twin listens
        return 130
    return 0


def _serve(options: Namespace, arguments: list[str]) -> None:
    settings = options.twin
    with ExitStack() as stack:
        twin = Twin(settings)
        record = None
        if options.record:
            about = {"robot": "twin", "layout": settings.layout.name, "place": settings.place}
            record = RawLogWriter(options.record, {**about, "clock": options.clock, "arguments": arguments})
            record.wait_ready()
            if record.failure:
                raise BackendError(record.failure)
            stack.callback(record.close)
        tap = record.append if record else None
        server = stack.enter_context(Server(twin, options.address, options.mocap, tap))
        with server.until_signalled():
            print(
                f"twin of the {settings.layout.name} ({settings.place}), not a robot: "
                f"{options.address[0]}:{server.port}, {options.clock}",
                flush=True,
            )
            if options.clock == "lockstep":
                server.serve_in_lock_step()
            else:
                server.serve_in_real_time()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
