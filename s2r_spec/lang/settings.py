"""The check of ``certify`` lines: keys, ranges of values, and the kernel's lengthscales."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

from s2r_spec.base.magnitude import beyond
from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import CertifySettings, KernelChoice, KernelName, Param
from s2r_spec.lang.diagnostics import suggestion
from s2r_spec.lang.expressions import quantity, value
from s2r_spec.lang.scope import Scope, each, fail
from s2r_spec.lang.units import PLAIN

_KERNELS: tuple[KernelName, ...] = get_args(KernelName)
_KEYS = ("delta", "epsilon", "B", "R", "kernel", "fall", "gap_B", "gap_R", "gap_epsilon")


def certify_settings(written: syntax.Certify, requirement: f.Formula | None, scope: Scope) -> CertifySettings:
    """Check a certify line; if its requirement is unknown, do not check the units of all settings but delta and kernel.

    Raises:
        Mistake: the line has mistakes; the error lists all of them.
    """
    first: dict[str, syntax.Word] = {}

    def one(setting: syntax.Setting) -> tuple[str, object]:
        key = setting.key.text
        if key not in _KEYS:
            guess = suggestion(key, _KEYS)
            message = f"`{key}` is not a setting of `certify`"
            fail("E12", message, setting.key.span, guess or f"the settings are {', '.join(_KEYS)}")
        if key in first:
            fail("E12", f"`{key}` is given twice", setting.key.span, declared_at=first[key].span)
        first[key] = setting.key
        if key == "kernel":
            return key, _kernel(setting.value, scope)
        return key, _number(setting, requirement, scope)

    values: Mapping[str, object] = dict(each(one, written.settings))
    return CertifySettings(**values)  # type: ignore[arg-type]  # each key was checked with its value


def _number(setting: syntax.Setting, requirement: f.Formula | None, scope: Scope) -> float:
    key, span = setting.key.text, setting.value.span
    if key == "delta":
        unit = None
    elif requirement is None:
        unit = value(setting.value, scope).unit
    else:
        unit = None if requirement.unit in (None, PLAIN, f.MIXED) else requirement.unit
    number = quantity(setting.value, scope, unit, f"`{key}`")
    if key == "delta" and not 0 < number < 1:
        message = f"`delta` must be a probability between 0 and 1, not {number:g}"
        fail("E13", message, span, "for example `delta = 1e-6`")
    if key not in ("delta", "fall") and number <= 0:
        fail("E13", f"`{key}` must be positive, not {number:g}", span)
    if key == "fall" and number >= 0:
        fail(
            "E13", f"`fall` must be negative, not {number:g}: a failed rollout satisfies no requirement", span
        )
    if outside := beyond(abs(number)) if number else "":
        fail("E13", f"`{key}` = {number:g} is {outside}", span)
    return number


def _kernel(written: syntax.Expression, scope: Scope) -> KernelChoice:
    usage = "write `matern52(0.2)`, with one lengthscale or one for each parameter"
    if not isinstance(written, syntax.Call):
        fail("E14", f"`{written.span.text}` is not a kernel with lengthscales", written.span, usage)
    name = written.function.text
    if name not in _KERNELS:
        guess = suggestion(name, _KERNELS)
        known = f"the kernels are {', '.join(sorted(_KERNELS))}"
        fail("E14", f"there is no kernel `{name}`", written.function.span, guess or known)
    axes = [item for item in scope.declared.values() if isinstance(item, Param) and item.searched]
    scales, count = list(written.arguments), len(written.arguments)
    if not axes:
        fail("E14", "a kernel needs a test space, but no `param` has a range", written.span)
    if count not in (1, len(axes)):
        names = ", ".join(axis.name for axis in axes)
        fail(
            "E14",
            f"there are {count} lengthscales for {len(axes)} searched parameter{'s' if len(axes) > 1 else ''}: {names}",
            written.span,
            usage,
        )
    pairs = list(zip(scales * len(axes) if count == 1 else scales, axes, strict=True))
    return KernelChoice(name, tuple(_lengthscale(scale, axis, scope) for scale, axis in pairs))


def _lengthscale(written: syntax.Expression, axis: Param, scope: Scope) -> float:
    # a lengthscale is a difference: one in K fits a parameter in degC
    unit = axis.measure.difference
    number = quantity(written, scope, None if unit == PLAIN else unit, f"the lengthscale of `{axis.name}`")
    if number <= 0:
        fail("E14", f"a lengthscale must be positive, not {number:g}", written.span)
    if outside := beyond(number):
        fail("E14", f"the lengthscale of `{axis.name}`, {number:g}, is {outside}", written.span)
    return number
