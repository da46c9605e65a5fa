"""What may follow the colon in the name of the backend."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

from s2r_sim.settings import Feedback, Form, Settings
from s2r_spec.errors import UsageError, did_you_mean, one_of

_OPTIONS: dict[str, tuple[str, ...]] = {"feedback": get_args(Feedback), "form": get_args(Form)}


def with_options(settings: Settings, text: str) -> Settings:
    """Return the settings with ``"feedback=estimate,form=full"`` or a part of it read into them.

    Raises:
        UsageError: a name or a value is unknown; the message lists those that are not.
    """
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        if name not in _OPTIONS:
            raise UsageError(
                f"the backend 'sim' has no option {name!r}{did_you_mean(name, _OPTIONS)}; "
                f"it has {one_of(_OPTIONS)}, written as feedback=estimate"
            )
        if value not in _OPTIONS[name]:
            raise UsageError(f"{name} = {value!r} is not one of {one_of(_OPTIONS[name])}")
        chosen: dict[str, Any] = {name: value}
        settings = replace(settings, **chosen)
    return settings
