"""All effects of the generator: those that the catalogue has, in another form, and those that it does not."""

from benchmarks.blind.a1.effects.bodies import BODIES
from benchmarks.blind.a1.effects.drives import DRIVES
from benchmarks.blind.a1.effects.ground import GROUND
from benchmarks.blind.a1.effects.kind import Kind
from benchmarks.blind.a1.effects.senses import SENSES
from benchmarks.blind.a1.effects.unknown import NEAR, UNLIKE

KNOWN: dict[str, Kind] = {kind.name: kind for kind in (*DRIVES, *GROUND, *BODIES, *SENSES)}
UNKNOWN: dict[str, Kind] = {kind.name: kind for kind in (*UNLIKE, *NEAR)}

__all__ = ["KNOWN", "NEAR", "UNKNOWN", "UNLIKE", "Kind"]
