"""The tables of docs/how-to/hardware.md and docs/reference/a1-robot.md, from the code itself.

Run: python -m benchmarks.a1.hardware_tables --write

``tests/a1/test_docs.py`` holds the pages to what this makes. A table stands between two comments that name it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

from benchmarks.tables import table
from s2r_a1 import attendance, excitation, remote, schedule
from s2r_a1.backend import AROUND, PARAMETERS, PLACING
from s2r_a1.channels import channels
from s2r_a1.guard import leg, moves, states
from s2r_a1.guard.checks import LimitCheck
from s2r_a1.guard.limits import LIMITS, MS, ROBOT_WORDS, SECOND, Limits
from s2r_a1.guard.states import RULES, State
from s2r_a1.protocols import PROTOCOLS, height_in_rig
from s2r_sim.controller.gains import RATE

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = (DOCS / "how-to" / "hardware.md", DOCS / "reference" / "a1-robot.md")
_BLOCK = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.S)


def ms(time: int) -> str:
    return f"{time / MS:g} ms"


def seconds(time: int) -> str:
    return f"{time / SECOND:g} s"


def means() -> dict[str, str]:
    """Name of a check → the condition at which it finds something."""
    k = LIMITS
    buttons = [" + ".join(names) for names in remote.STOPS]
    return {
        "tilt": f"the base is tilted by more than {k.tilt:g} rad",
        "height": f"the base is less than {k.height:g} m above the lowest foot, according to the legs' geometry",
        "motor": "a motor is not in closed loop (mode 10), or reports an error",
        "heat": f"a motor has {k.hot:g} °C or more",
        "warmth": f"a motor has {k.warm:g} °C or more",
        "torque": f"a motor reports more than {k.torque:g} N·m in {k.torque_rounds} states in a row",
        "strain": f"a motor reports more than {k.strain:g} N·m for {seconds(k.strain_time)}",
        "power": f"Σ\\|q̇ τ\\| above {k.watts:g} W (level {k.power_level}): {k.power_rounds} more states "
        "above it than below",
        "joint": f"a joint is within {k.margin:g} rad of its limit",
        "deviation": f"a joint is more than {k.deviation:g} rad from its target in the guard's own motion",
        "link": f"no new state for {ms(k.silence)}",
        "absence": f"no new state for {seconds(k.absence)}",
        "numbers": "two states in a row have impossible numbers",
        "button": f"{', '.join(buttons[:-1])} or {buttons[-1]} is pressed",
        "client": f"the walking program sends no usable order for {ms(k.silence)}",
        "guard": f"the guard itself is {ms(k.silence)} late",
    }


def outcome(word: str) -> str:
    return "counts" if word in ROBOT_WORDS else "void"


SENT: dict[State, str] = {
    State.OFF: "nothing",
    State.LINKED: "packets with all gains and torques zero",
    State.ARMED: "the same as in LINKED",
    State.STANDING_UP: f"a path from the measured angles to the stand, in {seconds(moves.STAND_UP)}",
    State.STAND: "the stand, held",
    State.WALK: "the walking program's orders, within the limits of orders",
    State.EXCITE: "the references of a protocol on the ground, within the limits of orders",
    State.EXCITE_HELD: "the same in a rig",
    State.LYING_DOWN: f"a path from the stand to the ground, in {seconds(moves.LIE_DOWN)}",
    State.RESTING: f"damping: Kd = {moves.DAMPING:g} N·m·s/rad, all else zero",
    State.DAMPING: "the same damping as in RESTING",
}
LEAVES: dict[State, str] = {
    State.OFF: "consent *connect* → LINKED",
    State.LINKED: "consent *arm* → ARMED",
    State.ARMED: "a test → STANDING_UP",
    State.STANDING_UP: "the end of the path → STAND",
    State.STAND: "a test → WALK; a protocol → EXCITE or EXCITE_HELD; lie → LYING_DOWN",
    State.WALK: "the end of the test, or a stop → STAND",
    State.EXCITE: "the end of the protocol, or a stop → STAND",
    State.EXCITE_HELD: "the same as in EXCITE",
    State.LYING_DOWN: "the end of the path → RESTING",
    State.RESTING: "the next test → STANDING_UP",
    State.DAMPING: "only the operator's reset → LINKED",
}


def state_table() -> str:
    return table(
        ("state", "what the guard sends", "what ends it"),
        [(state, SENT[state], LEAVES[state]) for state in RULES],
    )


def limit_table() -> str:
    """Each limit, and in which states it damps the robot."""
    shown = (
        *(State.ARMED, State.STANDING_UP, State.STAND, State.WALK, State.EXCITE, State.EXCITE_HELD),
        *(State.LYING_DOWN, State.RESTING),
    )
    checks: dict[str, LimitCheck] = {}
    for state in (State.WALK, State.STAND, State.STANDING_UP, *RULES):
        checks |= {check.name: check for check in RULES[state].checks if check.name not in checks}
    conditions = means()
    rows = []
    for check in sorted(checks.values(), key=lambda check: check.word not in ROBOT_WORDS):
        holds = ("yes" if check in RULES[state].checks else "–" for state in shown)
        rows.append((conditions[check.name], f"{check.word}, {outcome(check.word)}", *holds))
    return table(("condition", "word", *(state.replace("_", " ") for state in shown)), rows)


def warning_table() -> str:
    """Return the conditions that only print a warning."""
    warned: dict[str, list[str]] = {}
    for state, row in RULES.items():
        for check in row.warnings:
            warned.setdefault(check.name, []).append(state)
    return table(
        ("warning", "in the states"), [(means()[name], ", ".join(held)) for name, held in warned.items()]
    )


def order_table() -> str:
    """Return how the guard limits the walking program's orders."""
    k = LIMITS
    joints = ", ".join(
        f"{name} {low:g} to {high:g}"
        for name, low, high in zip(("hip", "thigh", "calf"), k.lowest, k.highest, strict=True)
    )
    return table(
        ("order", "beyond this", "becomes"),
        [
            ("torque", f"±{k.torque:g} N·m", "the limit"),
            ("angle", f"{joints} rad", "the limit"),
            ("Kp", f"{k.kp:g} N·m/rad", "the limit"),
            ("Kd", f"{k.kd:g} N·m·s/rad", "the limit"),
            ("speed", f"±{k.speed:g} rad/s", "none: speed and Kd of that motor are zero"),
            (
                "any",
                "NaN, infinity, a gain below zero, a wrong checksum",
                "dropped, as if it had not arrived",
            ),
            ("any", f"{ms(k.bridged)} old, or {k.dropped} dropped in a row", "repeated without its torque"),
            ("any", f"{ms(k.silence)} old", "DAMPING"),
        ],
    )


def impossible_table() -> str:
    """Return the impossible numbers of a state."""
    k = LIMITS
    return table(
        ("number", "impossible if"),
        [
            ("quaternion", f"its norm differs from 1 by more than {k.norm:g}"),
            ("gyroscope", f"more than {k.wild_turn:g} rad/s about an axis"),
            ("joint angle", f"more than {k.wild_angle:g} rad beyond the joint's limit"),
            ("joint speed", f"more than {k.wild_speed:g} rad/s"),
            ("any", "NaN or infinite"),
        ],
    )


def arming_table() -> str:
    """Return the conditions for arming."""
    k = LIMITS
    return table(
        ("arming needs", "if not"),
        [
            ("states from the robot, without impossible numbers", "check power, address and cable"),
            ("a clock in ms or µs, measured over 0.5 s", "the address is not the motion controller's"),
            ("all motors in mode 10, without an error", "switch the robot off and on"),
            (f"all motors below {k.warm:g} °C", "let them cool"),
            (
                f"all joints slower than {k.still:g} rad/s for {seconds(k.still_time)}",
                "end the factory's controller",
            ),
            ("a remote that is on, without a stop pressed (not for a twin)", "switch it on"),
        ],
    )


def time_table() -> str:
    """Return durations."""
    return table(
        ("time", "value"),
        [
            ("standing up, lying down", f"{seconds(moves.STAND_UP)}, {seconds(moves.LIE_DOWN)}"),
            ("trotting in place before t = 0", f"at least {schedule.TROT / RATE:g} s"),
            ("ramp from the command to zero", f"{schedule.RAMP / RATE:g} s"),
            (
                "a rollout in addition to the test itself",
                f"{AROUND:g} s, and {PLACING:g} s for putting the robot back",
            ),
            ("a walk ends after the first Ctrl-C within", f"{seconds(states.RAMP)}"),
            ("from a walk to the stand", f"{seconds(moves.CATCH)}"),
            ("from the stand to the first pose of a protocol, and back", f"{excitation.GOING:g} s each"),
            ("a rehearsal of a protocol, at most", f"{excitation.REHEARSED:g} s"),
            ("a damped robot can be reset after", f"{seconds(states.SINKING)}"),
            ("tests between two rests", f"{attendance.TESTS}"),
            (
                "a rest for heat begins at, and ends below",
                f"{attendance.WARM:g} °C, {attendance.COOL:g} °C",
            ),
        ],
    )


def figure_table() -> str:
    """Return every figure of the guard's limits."""
    rows = []
    for field in fields(Limits):
        figure = field.metadata["figure"]
        value = getattr(LIMITS, field.name)
        if isinstance(value, leg.Legs):
            shown = ", ".join(f"{part} {number}" for part, number in vars(value).items())
        elif isinstance(value, tuple):
            shown = ", ".join(f"{one:g}" for one in value)
        elif figure.unit == "ns":
            shown, figure = ms(value).removesuffix(" ms"), figure._replace(unit="ms")
        else:
            shown = f"{value:g}"
        rows.append((f"`{field.name}`", shown, figure.unit, figure.source, figure.twice))
    return table(("figure", "value", "unit", "source", "if it doubles"), rows)


def parameter_table() -> str:
    return table(
        ("parameter", "unit", "range", ""),
        [
            (f"`{p.name}`", p.unit.replace("|", "\\|"), f"{p.low:g} to {p.high:g}", p.description)
            for p in PARAMETERS
        ],
    )


def protocol_table() -> str:
    """Return the protocols, with the ranges of their gains and the place of the base."""
    rows = []
    for protocol in PROTOCOLS:
        gain = next(p for p in protocol.parameters if p.name == "gain")
        height = height_in_rig(protocol.name)
        where = "on the floor" if height is None else f"base {height:g} m above the floor"
        gains = f"{gain.low:g} to {gain.high:g}; {gain.default:g}"
        rows.append(
            (
                f"`{protocol.name}`",
                where,
                f"{protocol.duration:g} s",
                gains,
                protocol.words,
                protocol.risk or "–",
            )
        )
    return table(
        ("protocol", "where", "duration", "gain: range; default", "what the machine does", "risk"), rows
    )


def channel_table() -> str:
    return table(
        ("channel", "unit", "width", ""),
        [
            (f"`{c.name}`", c.unit, c.width, c.description)
            for c in channels("from the source that `velocity` names")
        ],
    )


TABLES: dict[str, Callable[[], str]] = {
    "states": state_table,
    "limits": limit_table,
    "warnings": warning_table,
    "orders": order_table,
    "impossible": impossible_table,
    "arming": arming_table,
    "times": time_table,
    "figures": figure_table,
    "parameters": parameter_table,
    "protocols": protocol_table,
    "channels": channel_table,
}


def with_tables(page: str) -> str:
    """Return a page with its tables made anew."""
    return _BLOCK.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", page)


def main() -> None:
    if "--write" not in sys.argv[1:]:
        print("\n\n".join(make() for make in TABLES.values()))
        return
    for page in PAGES:
        page.write_text(with_tables(page.read_text()))


if __name__ == "__main__":
    main()
