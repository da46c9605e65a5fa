"""Options after the colon of the backend's name: read from text, and written as text."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

from s2r_sim.controller.gains import Feedback, Form
from s2r_sim.effects import CATALOGUE
from s2r_sim.settings import Record, Settings
from s2r_spec.effects import Choice, choose, read_word, words
from s2r_spec.errors import UsageError, did_you_mean, one_of

_OPTIONS: dict[str, tuple[str, ...]] = {
    "feedback": get_args(Feedback),
    "form": get_args(Form),
    "record": get_args(Record),
}


def read_options(text: str, settings: Settings, added: Choice) -> tuple[Settings, Choice]:
    """Return settings and effects with the options of a text such as ``feedback=estimate,latency.delay=0.004``.

    Raises:
        UsageError: a name or a value is unknown; the message lists the valid ones.
    """
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        if values := read_word(word):
            added = choose("sim", CATALOGUE.values(), added, values)
            continue
        if name not in _OPTIONS:
            raise UsageError(
                f"the backend 'sim' has no option {name!r}{did_you_mean(name, _OPTIONS)}; it has {one_of(_OPTIONS)} "
                f"(feedback=estimate), and every parameter of every effect (latency.delay=0.004)"
            )
        if value not in _OPTIONS[name]:
            raise UsageError(f"{name} = {value!r} is not one of {one_of(_OPTIONS[name])}")
        chosen: dict[str, Any] = {name: value}
        settings = replace(settings, **chosen)
    return settings, added


def write_options(settings: Settings, added: Choice) -> str:
    """Return the text from which :func:`read_options` gives these settings and effects, without defaults."""
    nominal = Settings()
    changed = [
        f"{name}={getattr(settings, name)}"
        for name in _OPTIONS
        if getattr(settings, name) != getattr(nominal, name)
    ]
    return ",".join(changed + words(added))
