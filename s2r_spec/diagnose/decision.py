"""The verdict: one word from sizes, the gap, the misfit, what is left of the motion and suspected mistakes.

The gap *shows* if it is material at held-out or other tests (:mod:`.gap.held_out`), or matters at any test, early ends
included (:mod:`.gap.materiality`). Two simulators close it where it shows: that with the named effects, and that with
the posterior mean of all. The better one counts. The first rule that holds decides:

| rule | condition | verdict |
| --- | --- | --- |
| BROKEN | recordings break the law of the controller: nothing is estimated from them | none of these |
| LEFT | a misfit shows, and the most probable set leaves over a quarter of it | none of these |
| REMAINDER | the gap shows, some motion no effect explains, and named effects close less than 80 % | none of these |
| STAYS | surely not all is closed, and less than half with an effect named, else less than 80 % | none of these |
| END | a named value is at the end of its range, and surely less than 80 % is closed | none of these |
| MISTAKE | an effect is named, and a mistake of the recordings explains more | none of these |
| ALIKE | an effect is named, and a mistake of the recordings explains as much | confounded |
| ALONE | a mistake of the loop is named; the simulator fails with it, so no effect is estimated | confounded |
| RIVALS | an effect is named, and more likely than not another one is large, or a mistake there | confounded |
| OPEN | an effect is named, and an allowed experiment would settle a possible one | confounded |
| EFFECT | an effect is named, or a mistake of the loop | named |
| EITHER | more likely than not an effect is large, or a mistake there, or a named one does not count | confounded |
| SPREAD | the gap shows | no single cause |
| NONE | else | no material gap |

An effect is *named* by its size alone (:mod:`.inference.estimates`): it is a fact about the machine, and may matter for
another requirement. It does not count if its patch makes a material gap where there is none.

These rules keep two promises. *No material gap* is never said of a gap that shows. No cause is named that surely leaves
the gap. A rest of the motion is no verdict where no gap is left: every machine differs from its simulator in ways that
no requirement asks about.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from s2r_spec.base.verdict import Tone, Toned
from s2r_spec.diagnose.experiment_design.identifiability import Separation
from s2r_spec.diagnose.gap.held_out import CLOSED, HeldOutGap
from s2r_spec.diagnose.gap.materiality import Materiality
from s2r_spec.diagnose.gap.shares import GONE
from s2r_spec.diagnose.inference.estimates import EffectEstimate, Status
from s2r_spec.diagnose.inference.misfit import Misfit
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.loop import Loop
from s2r_spec.diagnose.residuals.left import Remainder


class Verdict(Toned):
    """What the diagnosis says, in the user's words."""

    NONE = "no material gap", Tone.GOOD
    SPREAD = "no single cause", Tone.OPEN
    """A gap that shows, without a cause that stands out."""
    NAMED = "named", Tone.GOOD
    CONFOUNDED = "confounded", Tone.OPEN
    UNKNOWN = "none of these", Tone.OPEN


class Rule(Enum):
    """The rule behind a verdict; see the table of this module."""

    BROKEN = "broken", Verdict.UNKNOWN
    LEFT = "left", Verdict.UNKNOWN
    REMAINDER = "remainder", Verdict.UNKNOWN
    STAYS = "stays", Verdict.UNKNOWN
    END = "end", Verdict.UNKNOWN
    MISTAKE = "mistake", Verdict.UNKNOWN
    ALIKE = "alike", Verdict.CONFOUNDED
    ALONE = "alone", Verdict.CONFOUNDED
    RIVALS = "rivals", Verdict.CONFOUNDED
    OPEN = "open", Verdict.CONFOUNDED
    EFFECT = "effect", Verdict.NAMED
    EITHER = "either", Verdict.CONFOUNDED
    SPREAD = "spread", Verdict.SPREAD
    NONE = "none", Verdict.NONE

    @property
    def word(self) -> str:
        """The rule behind the verdict."""
        return self.value[0]

    @property
    def verdict(self) -> Verdict:
        """What this rule answers."""
        return self.value[1]


@dataclass(frozen=True)
class Evidence:
    """What a verdict rests on; None and () stand for what was not measured.

    Attributes:
        effects: estimate of every effect.
        further: possible effects, of which more likely than not one is at least a quarter of typical.
        misfit: what the most probable set leaves of the difference of the traces.
        separations: what other experiments would say about each possible effect.
        left: motion that no effect explains.
        findings: suspected mistakes of the recordings.
        loop: the loop that the recordings show. Effects are estimated with this loop.
    """

    effects: tuple[EffectEstimate, ...]
    further: tuple[str, ...] = ()
    misfit: Misfit | None = None
    separations: tuple[Separation, ...] = ()
    held_out: HeldOutGap | None = None
    materiality: Materiality | None = None
    left: Sequence[Remainder] = ()
    findings: Sequence[Finding] = ()
    loop: Loop | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """The named effects, in the order of the catalogue."""
        return tuple(one.effect for one in self.effects if one.status is Status.NAMED)

    @property
    def at_end(self) -> tuple[str, ...]:
        """The parameters of the named effects whose value is at the end of its range."""
        return tuple(
            f"{one.effect}.{each.parameter}"
            for one in self.effects
            for each in one.parameters
            if one.status is Status.NAMED and each.at_end
        )

    @property
    def mistakes(self) -> tuple[str, ...]:
        """The mistakes of the machine's loop, in words."""
        return () if self.loop is None else self.loop.names

    @property
    def doubtful(self) -> tuple[str, ...]:
        """The effects, and loops with a mistake, of which more likely than not one is there beside what is named."""
        return (*self.further, *(self.loop.possible if self.loop else ()))

    @property
    def open(self) -> tuple[str, ...]:
        """The possible effects that an allowed experiment would settle."""
        return tuple(one.effect for one in self.separations if one.best(allowed=True))

    @property
    def answer(self) -> tuple[str, ...]:
        """The effects that the verdict names."""
        return self.named if self.rule() in (Rule.ALIKE, Rule.RIVALS, Rule.OPEN, Rule.EFFECT) else ()

    @property
    def shows(self) -> bool:
        """Whether the gap is material or matters anywhere."""
        far, matters = self.held_out, self.materiality
        held = far is not None and (far.material or far.elsewhere)
        return held or (matters is not None and matters.matters)

    @property
    def rivals(self) -> tuple[Finding, ...]:
        """The suspected mistakes that do the same as an effect."""
        return tuple(one for one in self.findings if one.imitates)

    def rule(self) -> Rule:
        """Return the first rule that holds."""
        far, shows = self.held_out, self.shows
        named = bool(self.named or self.mistakes) and not (far is not None and far.harmful)
        if any(one.certain for one in self.findings):
            return Rule.BROKEN
        if self.misfit is not None and self.misfit.rejected:
            return Rule.LEFT
        if shows and any(one.material for one in self.left) and not (far and far.explained):
            return Rule.REMAINDER
        if far is not None and far.stays(CLOSED if named else GONE):
            return Rule.STAYS
        if far is not None and far.short and self.at_end:
            return Rule.END
        if named and self.named and any(not one.same for one in self.rivals):
            return Rule.MISTAKE
        if named and self.named and self.rivals:
            return Rule.ALIKE
        if named and not self.effects:
            return Rule.ALONE
        if named and self.doubtful:
            return Rule.RIVALS
        if named:
            return Rule.OPEN if self.open else Rule.EFFECT
        if self.named or self.mistakes or self.doubtful:
            return Rule.EITHER
        return Rule.SPREAD if shows else Rule.NONE
