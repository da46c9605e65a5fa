"""The options after the colon of a backend's name, such as ``feedback=estimate,latency.delay=0.004``."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from s2r_spec.backend.effects import Choice, choose, read_word
from s2r_spec.backend.model import Effect
from s2r_spec.base.errors import UsageError, one_of, suggest


def read_options(
    backend: str,
    text: str,
    options: Mapping[str, Collection[str]],
    catalogue: Iterable[Effect] = (),
    before: Choice = (),
) -> tuple[dict[str, str], Choice]:
    """Return the value of each option in a text, and the effects that the text adds.

    Args:
        backend: name of the backend, for messages.
        text: words NAME=VALUE and EFFECT.PARAMETER=VALUE, separated by commas.
        options: name of each option → its valid values; () if any text is valid.
        catalogue: effects whose parameters are options, too.
        before: effects that were added before.

    Raises:
        UsageError: a name or a value is unknown, an option is given twice, or a value is out of range.
    """
    settings: dict[str, str] = {}
    choice, catalogue = before, tuple(catalogue)
    of_effects = [f"{effect.name}.{p.name}" for effect in catalogue for p in effect.parameters]
    for word in filter(None, (word.strip() for word in text.split(","))):
        name, _, value = word.partition("=")
        if name in (*options, *of_effects) and not value:
            raise UsageError(f"the option {name!r} of the backend {backend!r} needs a value: {name}=VALUE")
        if name in options:
            if name in settings:
                raise UsageError(
                    f"the option {name} has two values, {settings[name]!r} and {value!r}; give one"
                )
            if options[name] and value not in options[name]:
                raise UsageError(f"{name} = {value!r} is not one of {one_of(options[name])}")
            settings[name] = value
        elif of_effects and value and "." in name:
            choice = choose(backend, catalogue, choice, read_word(word) or {})
        else:
            valid = [one_of(options)] if options or not of_effects else []
            valid += [f"the parameters of its effects, such as {of_effects[0]}"] if of_effects else []
            raise UsageError(
                f"the backend {backend!r} has no option {name!r}{suggest(name, [*options, *of_effects])} "
                f"it has {' and '.join(valid)}"
            )
    return settings, choice
